from bench.api import BenchError as BenchError
from bench.api import Checked as Checked
from bench.api import Fit as Fit
from bench.api import Session as Session
from bench.api import check as check
from bench.api import fit as fit
from bench.api import load as load
from bench.api import run as run
from bench.api import to_xarray as to_xarray
from bench.api import watch as watch

__version__: str
__bench__: str
