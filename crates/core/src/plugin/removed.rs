//! Fields that plugins once had, for the error of a file that still sets one.

/// Plugins, their removed field, and the next step in place of it.
pub const REMOVED_FIELDS: &[(&[&str], &str, &str)] = &[
    (
        &[
            "GreedyElimination",
            "LightGaussian",
            "MergeByMoments",
            "Pup3dgs",
            "RandomReference",
            "SignalContribution",
            "SpeedySplat",
            "Taming3dgs",
        ],
        "shares",
        "set training.target_count",
    ),
    (&["GaussianSpa"], "share", "set training.target_count"),
    (&["LightGaussian"], "volume_power", "remove it (fixed at 0.1), or use SignalContribution() to ignore the volume"),
    (&["Pup3dgs"], "ridge", "remove it (fixed at 1e-6)"),
    (&["Mcmc"], "dead", "remove it (fixed at 0.005)"),
    (&["Mcmc"], "grow", "remove it (fixed at 0.05)"),
    (&["Mcmc"], "opacity_weight", "remove it (fixed at 0.01)"),
    (&["Mcmc"], "scale_weight", "remove it (fixed at 0.01)"),
    (&["MaskGaussian"], "initial_logit", "remove it (fixed at 1.0)"),
    (&["MaskGaussian"], "draws", "remove it (fixed at 10)"),
    (&["Lp3dgs"], "initial_logit", "remove it (fixed at 3.0)"),
    (&["Lp3dgs"], "temperature", "remove it (fixed at 0.5)"),
    (&["MiniSplatting"], "per_area", "remove it (the weight is a sum)"),
    (&["SafeguardGs"], "of_pixel", "remove it (fixed at 1)"),
    (&["NaturalSelection"], "memory", "remove it (fixed at 0.9)"),
    (&["ControlGs"], "settle", "remove it (fixed at 0.01)"),
    (&["AroundReceivers", "Grid", "PointCloud", "Random"], "signal_scale", "remove it (fixed at 1.0)"),
    (&["Teacher"], "wavelength_m", "remove it (fixed at 1 to 2 m)"),
    (&["Teacher"], "rasterizer", "remove it (fixed at AlphaBlending())"),
    (&["MatchingPursuit"], "finer", "remove it (the search always goes from coarse to fine, down to `step`)"),
    (&["Nerf2"], "cache_mb", "remove it (fixed at 2500)"),
];

/// Returns the error for a removed field of a plugin; `None` for all other fields. The text begins with `has`: the caller names
/// the plugin.
pub fn removed_field(plugin: &str, field: &str) -> Option<String> {
    let (.., step) = REMOVED_FIELDS.iter().find(|(plugins, name, _)| *name == field && plugins.contains(&plugin))?;
    Some(format!("has no field `{field}` (removed); {step}"))
}
