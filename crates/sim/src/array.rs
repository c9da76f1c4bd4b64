//! The antenna array at the receiver: its channel and its spatial spectrum.
