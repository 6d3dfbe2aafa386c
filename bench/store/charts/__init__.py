"""Control charts of units, check standards, certificates and benches, from a first phase that stays."""

from bench.store.charts.chart import ChartedSeries, ChartedSubject
from bench.store.charts.phases import freeze
from bench.store.charts.populations import chart_certificates, chart_station
from bench.store.charts.units import chart_unit
