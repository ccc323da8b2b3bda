"""RT-DAC/USB, first generation."""
