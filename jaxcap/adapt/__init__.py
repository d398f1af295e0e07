"""What a template model's examples say of bodies to come: how joints turn together, how far, and the
shape around every vertex (Adaptation, section 4.1.1)."""
