//! Pipelines, experiments and scenes, stored in the program: `pwrfgs run quickstart` needs no file.
//!
//! The scene `conference` is not among them, because it reads a mesh file.

use pwrfgs_core::ShippedFile;
use pwrfgs_core::plugin::inventory;

/// Registers files as [`ShippedFile`].
macro_rules! ship {
    ($($folder:literal: $($name:literal),+;)+) => {$($(
        inventory::submit! { ShippedFile {
            folder: $folder,
            name: $name,
            source: include_str!(concat!("../", $folder, "/", $name, ".ron")),
        } }
    )+)+};
}

ship! {
    "pipelines":
        "ablation-wrfgs", "ablation", "ble", "dense", "nerf2-ble", "nerf2-csi", "nerf2-laptop", "nerf2",
        "newrf", "office-carriers", "office-channel", "office-init", "office-links", "office-moving", "pwrfgs-157",
        "pwrfgs-small", "pwrfgs", "quickstart", "s23-array", "s23-laptop", "thinned", "uplink", "wrfgs-laptop",
        "wrfgs-small", "wrfgs";
    "experiments":
        "array-blocks", "array", "ble-best", "curve-large", "curve", "ladder", "methods-channels", "methods-office",
        "methods-powers", "methods-uplink", "methods", "network", "office-start", "paper-office", "paper", "pareto",
        "s23-best", "s23-blocks", "size", "splits";
    "scenes":
        "lab-s23", "office-carriers", "office-channel", "office-csi", "office-links", "office-moving", "office";
}
