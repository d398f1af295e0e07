"""Data terms: points, surfaces, landmarks, the floor."""
