"""A surface whose vertices move freely: to a scan, near the surface that guides them."""
