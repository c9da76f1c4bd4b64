//! Points sampled on surfaces, and the PLY file that holds them.
