"""Models and motions of OpenSim."""
