//! Building materials of ITU-R P.2040.
