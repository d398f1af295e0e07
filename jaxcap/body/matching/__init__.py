"""Match the joints of two skeletons by names and kinematic trees."""
