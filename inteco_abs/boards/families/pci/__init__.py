"""RT-DAC4/PCI with the ABS logic."""
