//! Where transmitters stand.
