"""Mock boards as USB devices, exported to any Linux kernel over USB/IP."""
