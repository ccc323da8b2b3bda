"""The rig for tools of other fields. Each module needs its own extra, so this package loads none of them."""
