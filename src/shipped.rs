//! Pipelines, experiments, scenes and models, stored in the program: `pwrfgs run quickstart` and `pwrfgs view s23` need no file.
//!
//! The scene `conference` is not among them, because it reads a mesh file.

use pwrfgs_core::plugin::inventory;
use pwrfgs_core::{ShippedFile, ShippedModel};

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

/// Registers model files as [`ShippedModel`]: name, pipeline with its data, purpose.
macro_rules! ship_models {
    ($($name:literal, $pipeline:literal: $purpose:literal;)+) => {$(
        inventory::submit! { ShippedModel {
            name: $name,
            purpose: $purpose,
            pipeline: $pipeline,
            bytes: include_bytes!(concat!("../models/", $name, ".safetensors")),
        } }
    )+};
}

ship_models! {
    "ble", "ble": "Received power at 21 Bluetooth gateways (measured)";
    "office-channel", "office-channel": "Channels of a 4 x 4 array in an office at 2.4 GHz, 16 subcarriers (simulated)";
    "s23", "s23-laptop": "Spatial spectra of a 4 x 4 array in a room at 920 MHz (measured)";
}
