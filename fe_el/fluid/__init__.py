"""The fluid: volume-averaged Navier-Stokes equations on simplices."""
