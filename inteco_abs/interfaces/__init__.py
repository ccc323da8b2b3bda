"""The rig for tools of other fields. Most modules need an extra of their own, so this package loads none."""
