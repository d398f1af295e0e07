"""Learn animatable bodies from registered meshes."""
