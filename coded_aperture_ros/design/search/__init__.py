"""`coded_aperture mask search`: better masks than the published ones."""
