"""Linear regression problems with certified answers: NIST Statistical Reference Datasets, linear regression.

Certified values were computed there in 500-digit arithmetic and are quoted to 15 digits. Polynomial problems are
given by x and an order, the others by their columns.
"""

from dataclasses import dataclass
from decimal import Decimal, localcontext

import numpy as np
from numpy.typing import NDArray

from bench.maths.arrays import Floats
from bench.systems.af_converter.estimators.gates import Whitener


@dataclass(frozen=True)
class Problem:
    """One reference problem; ``order`` is -1 where ``x`` holds the columns themselves, (m, p)."""

    name: str
    y: tuple[float, ...]
    x: tuple
    order: int
    parameters: tuple[float, ...]
    deviations: tuple[float, ...]
    residual_deviation: float


_NORRIS = """
0.1 0.2  338.8 337.4  118.1 118.2  888.0 884.6  9.2 10.1  228.1 226.5  668.5 666.3  998.5 996.3  449.1 448.6
778.9 777.0  559.2 558.2  0.3 0.4  0.1 0.6  778.1 775.5  668.8 666.9  339.3 338.0  448.9 447.5  10.8 11.6
557.7 556.0  228.3 228.1  998.0 995.8  888.8 887.6  119.6 120.2  0.3 0.3  0.6 0.3  557.6 556.8  339.3 339.1
888.0 887.2  998.5 999.0  778.9 779.0  10.2 11.1  117.6 118.3  228.9 229.2  668.4 669.1  449.2 448.9  0.2 0.5
"""
_PONTIUS_Y = """
.11019 .21956 .32949 .43899 .54803 .65694 .76562 .87487 .98292 1.09146 1.20001 1.30822 1.41599 1.52399 1.63194
1.73947 1.84646 1.95392 2.06128 2.16844 .11052 .22018 .32939 .43886 .54798 .65739 .76596 .87474 .98300 1.09150
1.20004 1.30818 1.41613 1.52408 1.63159 1.73965 1.84696 1.95445 2.06177 2.16829
"""
_FILIP = """
0.8116 -6.860120914 0.9072 -4.324130045 0.9052 -4.358625055 0.9039 -4.358426747 0.8053 -6.955852379
0.8377 -6.661145254 0.8667 -6.355462942 0.8809 -6.118102026 0.7975 -7.115148017 0.8162 -6.815308569
0.8515 -6.519993057 0.8766 -6.204119983 0.8885 -5.853871964 0.8859 -6.109523091 0.8959 -5.79832982
0.8913 -5.482672118 0.8959 -5.171791386 0.8971 -4.851705903 0.9021 -4.517126416 0.909 -4.143573228
0.9139 -3.709075441 0.9199 -3.499489089 0.8692 -6.300769497 0.8872 -5.953504836 0.89 -5.642065153
0.891 -5.031376979 0.8977 -4.680685696 0.9035 -4.329846955 0.9078 -3.928486195 0.7675 -8.56735134
0.7705 -8.363211311 0.7713 -8.107682739 0.7736 -7.823908741 0.7775 -7.522878745 0.7841 -7.218819279
0.7971 -6.920818754 0.8329 -6.628932138 0.8641 -6.323946875 0.8804 -5.991399828 0.7668 -8.781464495
0.7633 -8.663140179 0.7678 -8.473531488 0.7697 -8.247337057 0.77 -7.971428747 0.7749 -7.676129393
0.7796 -7.352812702 0.7897 -7.072065318 0.8131 -6.774174009 0.8498 -6.478861916 0.8741 -6.159517513
0.8061 -6.835647144 0.846 -6.53165267 0.8751 -6.224098421 0.8856 -5.910094889 0.8919 -5.598599459
0.8934 -5.290645224 0.894 -4.974284616 0.8957 -4.64454848 0.9047 -4.290560426 0.9129 -3.885055584
0.9209 -3.408378962 0.9219 -3.13200249 0.7739 -8.726767166 0.7681 -8.66695597 0.7665 -8.511026475
0.7703 -8.165388579 0.7702 -7.886056648 0.7761 -7.588043762 0.7809 -7.283412422 0.7961 -6.995678626
0.8253 -6.691862621 0.8602 -6.392544977 0.8809 -6.067374056 0.8301 -6.684029655 0.8664 -6.378719832
0.8834 -6.065855188 0.8898 -5.752272167 0.8964 -5.132414673 0.8963 -4.811352704 0.9074 -4.098269308
0.9119 -3.66174277 0.9228 -3.2644011
"""
_LONGLEY = """
60323 83.0 234289 2356 1590 107608 1947  61122 88.5 259426 2325 1456 108632 1948
60171 88.2 258054 3682 1616 109773 1949  61187 89.5 284599 3351 1650 110929 1950
63221 96.2 328975 2099 3099 112075 1951  63639 98.1 346999 1932 3594 113270 1952
64989 99.0 365385 1870 3547 115094 1953  63761 100.0 363112 3578 3350 116219 1954
66019 101.2 397469 2904 3048 117388 1955  67857 104.6 419180 2822 2857 118734 1956
68169 108.4 442769 2936 2798 120445 1957  66513 110.8 444546 4681 2637 121950 1958
68655 112.6 482704 3813 2552 123366 1959  69564 114.2 502601 3931 2514 125368 1960
69331 115.7 518173 4806 2572 127852 1961  70551 116.9 554894 4007 2827 130081 1962
"""
_WAMPLER_2 = """
1.00000 1.11111 1.24992 1.42753 1.65984 1.96875 2.38336 2.94117 3.68928 4.68559 6.00000 7.71561 9.92992 12.75603
16.32384 20.78125 26.29536 33.05367 41.26528 51.16209 63.00000
"""
_WAMPLER_3 = """
760 -2042 2111 -1684 3888 1858 11379 17560 39287 64382 113159 175108 273291 400186 581243 811568 1121004 1506550
2002767 2611612 3369180
"""


def _numbers(text: str) -> np.ndarray:
    return np.array(text.split(), float)


def _pairs(text: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    y, x = _numbers(text).reshape(-1, 2).T.tolist()
    return tuple(y), tuple(x)


def _wampler(number: int) -> Problem:
    """Degree 5 on 0 ... 20; numbers 3 to 5 add the same residuals 1, 100 and 10,000 times."""
    x = range(21)
    exact = [sum(t**k for k in range(6)) for t in x]
    if number == 2:
        return Problem("Wampler2", tuple(_numbers(_WAMPLER_2)), tuple(x), 5,
                       tuple(float(f"1e-{k}") for k in range(6)), (0.0,) * 6, 0.0)  # fmt: skip
    size = {1: 0, 3: 1, 4: 100, 5: 10_000}[number]
    residual = [int(seen) - true for seen, true in zip(_numbers(_WAMPLER_3), exact, strict=True)]
    y = tuple(float(true + size * part) for true, part in zip(exact, residual, strict=True))
    deviations = (2152.32624678170, 2363.55173469681, 779.343524331583, 101.475507550350, 5.64566512170752,
                  0.112324854679312)  # fmt: skip
    return Problem(f"Wampler{number}", y, tuple(x), 5, (1.0,) * 6, tuple(size * d for d in deviations),
                   size * 2360.14502379268)  # fmt: skip


_longley = _numbers(_LONGLEY).reshape(-1, 7)
PROBLEMS = (
    Problem("Norris", *_pairs(_NORRIS), 1, (-0.262323073774029, 1.00211681802045),
            (0.232818234301152, 0.429796848199937e-3), 0.884796396144373),
    Problem("Pontius", tuple(_numbers(_PONTIUS_Y)), tuple(150_000.0 * (i % 20 + 1) for i in range(40)), 2,
            (0.673565789473684e-3, 0.732059160401003e-6, -0.316081871345029e-14),
            (0.107938612033077e-3, 0.157817399981659e-9, 0.486652849992036e-16), 0.205177424076185e-3),
    Problem("NoInt1", tuple(range(130, 141)), tuple((t,) for t in range(60, 71)), -1,
            (2.07438016528926,), (0.165289256198347e-1,), 3.56753034006338),
    Problem("NoInt2", (3.0, 4.0, 4.0), ((4.0,), (5.0,), (6.0,)), -1,
            (0.727272727272727,), (0.420827318078432e-1,), 0.369274472937998),
    Problem("Filip", *_pairs(_FILIP), 10,
            (-1467.48961422980, -2772.17959193342, -2316.37108160893, -1127.97394098372, -354.478233703349,
             -75.1242017393757, -10.8753180355343, -1.06221498588947, -0.670191154593408e-1, -0.246781078275479e-2,
             -0.402962525080404e-4),
            (298.084530995537, 559.779865474950, 466.477572127796, 227.204274477751, 71.6478660875927,
             15.2897178747400, 2.23691159816033, 0.221624321934227, 0.142363763154724e-1, 0.535617408889821e-3,
             0.896632837373868e-5), 0.334801051324544e-2),
    Problem("Longley", tuple(_longley[:, 0]), tuple(map(tuple, np.column_stack((np.ones(16), _longley[:, 1:])))), -1,
            (-3482258.63459582, 15.0618722713733, -0.358191792925910e-1, -2.02022980381683, -1.03322686717359,
             -0.511041056535807e-1, 1829.15146461355),
            (890420.383607373, 84.9149257747669, 0.334910077722432e-1, 0.488399681651699, 0.214274163161675,
             0.226073200069370, 455.478499142212), 304.854073561965),
    *(_wampler(number) for number in range(1, 6)),
)  # fmt: skip


def polynomial_columns(x: Floats, order: int) -> NDArray[np.object_]:
    """Columns 1, x, x^2 ... x^order, each power right to about 39 digits; a power in doubles is right to 15.

    Args:    x: (m,), any unit, taken as exact.   order: highest power, >= 0.
    Returns: decimals (m, order + 1), a design for bench.maths.least_squares.solve.
    Source:  definition.
    """
    base = np.frompyfunc(Decimal, 1, 1)(np.asarray(x, np.float64))
    with localcontext(prec=40):
        return np.multiply.accumulate(np.column_stack([0 * base + 1, *[base] * order]), axis=1)


def covariance_of(whitener: Whitener) -> Floats:
    """Return the covariance V itself, (m, m), in the unit of the readings squared."""
    rows = whitener.factor.shape[1]
    factor = sum(
        np.diag(diagonal[: rows - below], -below) for below, diagonal in enumerate(whitener.factor) if below < rows
    )
    return np.asarray(np.cumsum(np.cumsum(factor @ factor.T, axis=0), axis=1))
