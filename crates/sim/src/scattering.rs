//! Diffuse scattering off rough surfaces.
