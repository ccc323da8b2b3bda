import pytest

from tests.faults.stage import configured

SHORT = ("loop.rate_hz=500", "experiment.start_speed_rad_s=10", "experiment.idle_s=0.02", "experiment.hold_s=0.02")
"""A stop of some 280 ticks."""


@pytest.fixture(scope="session", params=["sim_usb2", "sim_usb", "sim_pci"])
def short(request):
    """Configuration of a short stop on each kind of board; the first generation's keeps 250 Hz."""
    slow = ("loop.rate_hz=250",) if request.param == "sim_usb" else ()
    return configured(*SHORT, *slow, profile=request.param)
