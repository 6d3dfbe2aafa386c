"""Logs of other systems in binary form (NumPy, MATLAB, HDF5, MCAP, ROS bags), read as the rows of one table."""

from bench.tables.foreign.messages import LOG_TIME
from bench.tables.foreign.opening import ForeignTable, kind_of, open_table, topics_of
from bench.tables.foreign.text import OtherLog
