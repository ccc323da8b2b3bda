"""RT-DAC/USB2."""
