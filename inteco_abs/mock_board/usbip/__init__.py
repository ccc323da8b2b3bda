"""The mock boards as USB devices, offered to any Linux kernel over USB/IP."""
