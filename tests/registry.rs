//! Every built-in plugin is linked by the facade, has defaults that pass its own check, and survives its own text.
use crate::common::built_in;
use pwrfgs::core::Method;
use pwrfgs::core::plugin::{PluginKind, ron_options};
use pwrfgs::prelude::*;

/// Exactly `expected` are linked, and each survives its own text.
fn linked<T: ?Sized + PluginKind>(expected: &[&str])
where
    Box<T>: for<'de> Deserialize<'de>,
    Plugin<T>: Serialize,
{
    let names = built_in::<T>();
    assert_eq!(names, expected, "{}", T::KIND);
    for name in names {
        let plugin = Plugin::<T>::parse(&format!("{name}()")).unwrap_or_else(|e| panic!("{name}: {e}"));
        let text = |p: &Plugin<T>| {
            let config = pretty();
            ron_options().to_string_pretty(p, config).unwrap()
        };
        let again = Plugin::<T>::parse(&text(&plugin)).unwrap_or_else(|e| panic!("{name}: {e}: {}", text(&plugin)));
        assert_eq!(text(&again), text(&plugin));
        assert!(text(&plugin).starts_with(name));
        assert!(!plugin.about_plugin().is_empty(), "{name} says nothing about itself");
    }
}

fn pretty() -> ron::ser::PrettyConfig {
    ron::ser::PrettyConfig::new().struct_names(true)
}

#[test]
fn every_built_in_name_is_registered() {
    linked::<dyn DataSource>(&["Arrays", "Channels", "Nerf2Csi", "Nerf2Rssi", "Nerf2Spectrum", "Simulated", "Teacher"]);
    linked::<dyn Split>(&["LeaveReceiverOut", "Official", "Random", "RandomLinks", "Sparse", "TimeBlock", "Voxel"]);
    linked::<dyn Baseline>(&[
        "Kriging",
        "LogDistance",
        "MeanSpectrum",
        "NearestNeighbours",
        "RayTracing",
        "Ridge",
        "Zero",
    ]);
    linked::<dyn Initializer>(&["Grid", "MatchingPursuit", "NoGaussians", "PointCloud", "Random", "Site", "Trained"]);
    linked::<dyn Projector>(&["Mercator", "WrfgsCompat"]);
    linked::<dyn Rasterizer>(&["AlphaBlending", "ArrayResponse"]);
    linked::<dyn Method>(&["Nerf2", "Splatting", "VirtualTransmitters"]);
    linked::<dyn Deformation>(&["Factored", "Fixed", "Mlp", "Wrfgs"]);
    linked::<dyn Pruner>(&[
        "ControlGs",
        "Eagles",
        "FastGs",
        "GaussianSpa",
        "GreedyElimination",
        "LearnableMask",
        "LightGaussian",
        "Lp3dgs",
        "MaskGaussian",
        "Mcmc",
        "MergeByMoments",
        "MiniSplatting",
        "NaturalSelection",
        "OpacityThreshold",
        "Pup3dgs",
        "RadSplat",
        "RandomReference",
        "Reduced3dgs",
        "SafeguardGs",
        "SignalContribution",
        "SpeedySplat",
        "Taming3dgs",
        "TopK",
        "TrimmingTheFat",
    ]);
    linked::<dyn Metric>(&[
        "Chamfer",
        "ChannelSnr",
        "DirectionError",
        "GaussianCount",
        "L1",
        "Latency",
        "ModelSize",
        "PowerError",
        "Psnr",
        "RateRatio",
        "Ssim",
    ]);
}
