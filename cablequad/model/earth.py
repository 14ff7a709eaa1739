"""Where the local frame lies on the earth, and what air and field are like there."""

import math
from typing import NamedTuple

import numpy as np

from cablequad.types import Array

RADIUS_M = 6378137.0
FIELD_GAUSS = np.array([0.2158, 0.0121, 0.4335])  # NED, at the default home (declination 3.2 deg, inclination 63.5)
SEA_LEVEL_HPA, LAPSE, POWER = 1013.25, 2.25577e-5, 5.25588  # of the standard atmosphere


class Home(NamedTuple):
    """Where local (0, 0, 0) lies, and when the vehicles' clock began."""

    latitude_deg: float = 47.397742
    longitude_deg: float = 8.545594
    altitude_m: float = 488.0
    epoch_s: int = 1_700_000_000


def geodetic(home: Home, x: Array) -> tuple[float, float, float]:
    """Latitude and longitude (deg) and altitude (m) of x (3,) m, W, on a sphere around the origin."""
    north, east, down = x.tolist()
    lat = home.latitude_deg + math.degrees(north / RADIUS_M)
    lon = home.longitude_deg + math.degrees(east / (RADIUS_M * math.cos(math.radians(home.latitude_deg))))
    return lat, lon, home.altitude_m - down


def local(home: Home, latitude_deg: float, longitude_deg: float, altitude_m: float) -> Array:
    """(3,) m, W: the place that `geodetic` tells of."""
    north = math.radians(latitude_deg - home.latitude_deg) * RADIUS_M
    east = math.radians(longitude_deg - home.longitude_deg) * RADIUS_M * math.cos(math.radians(home.latitude_deg))
    return np.array([north, east, home.altitude_m - altitude_m])


def pressure_hPa(altitude_m: float) -> float:
    """At an altitude above sea level, in the standard atmosphere; none where that ends, at 44 km."""
    return float(SEA_LEVEL_HPA * max(0.0, 1.0 - LAPSE * altitude_m) ** POWER)


def density_ratio(altitude_m: float) -> float:
    """Of the air at an altitude above sea level to that at sea level, in the standard atmosphere."""
    return float(max(0.0, 1.0 - LAPSE * altitude_m) ** (POWER - 1.0))


def altitude_m(pressure: float) -> float:
    """Above sea level, as a barometer makes it of its pressure (hPa)."""
    return float((1.0 - (pressure / SEA_LEVEL_HPA) ** (1.0 / POWER)) / LAPSE)
