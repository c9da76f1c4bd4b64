//! Diffraction at a straight edge: the uniform theory of diffraction.
