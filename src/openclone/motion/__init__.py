"""Human recordings become motions of the G1."""
