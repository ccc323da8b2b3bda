"""The mock board seen from its wire, one front end for each family."""
