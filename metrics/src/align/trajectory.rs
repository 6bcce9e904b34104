//! The similarity between two camera trajectories.
