"""Numbers that the paper on the time offset prints, and the flight they belong to.

Source: S. Lee et al., J. Korean Soc. Aeronaut. Space Sci. 48(4), 285-293 (2020), Tables 3-7, section 2.1.2.
"""

from __future__ import annotations

OFFSETS_ms = (0.0, 10.0, 20.0, 30.0)
POSITION_m = dict(zip(OFFSETS_ms, (0.3219, 1.045, 2.019, 3.01), strict=True))  # Table 5, latitude
VELOCITY_m_s = dict(zip(OFFSETS_ms, (0.03439, 0.08124, 0.1467, 0.2143), strict=True))  # Table 6, V_N
YAW_deg = dict(zip(OFFSETS_ms, (0.01347, 0.04958, 0.09429, 0.1396), strict=True))  # Table 7
SPEED_m_s, ACCELERATION_m_s2, RATE_deg_s = 100.0, 5.0, 4.5  # Table 4; 90 deg in 20 s
MANOEUVRE_s = (20.0, 40.0)
IMAGE_SPEED_m_s = 250.0  # 100 m/s and 10 s of 15 m/s2
