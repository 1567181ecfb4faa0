"""Reports of studies as pages."""
