"""Shipped rig and board profiles: data only."""
