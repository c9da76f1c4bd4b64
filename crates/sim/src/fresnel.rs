//! Reflection and transmission of plane waves at half-spaces and slabs.
