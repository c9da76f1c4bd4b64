//! Compares the tiled kernel with brute force on random scenes.

use crate::common::{reference, relative, signals, splats};
use proptest::prelude::*;
use pwrfgs_core::{Rasterizer, Real};
use pwrfgs_raster::AlphaBlending;

/// Bound on relative differences: rounding, and in single precision occasional pixels whose γ is within rounding of
/// 1/255, so that only one implementation draws the splat.
const TOLERANCE: Real = if size_of::<Real>() == 8 { 1e-9 } else { 5e-3 };

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn tiled_rendering_equals_untiled_reference(
        n in 1usize..60, seed in 0u64..10_000, channels in 1usize..5, width in 40usize..130, height in 10usize..60,
    ) {
        let (splats, plane) = splats(n, seed, width, height);
        let signals = signals(n, channels, seed);
        let raster = AlphaBlending::default();
        let render = raster.forward(splats.with_signals(&signals, channels, &plane));
        let (pixels, light) = reference::forward(&splats, &signals, channels, &plane);
        prop_assert!(relative(&pixels, &render.pixels) < TOLERANCE);
        prop_assert!(relative(&light, &render.transmittance) < TOLERANCE);

        let d: Vec<Real> = (0..pixels.len()).map(|k| (k as Real * 0.37).sin()).collect();
        let ours = raster.backward(splats.with_signals(&signals, channels, &plane), &render, &d);
        let theirs = reference::backward(&splats, &signals, channels, &plane, &d);
        prop_assert!(relative(&theirs.signals, &ours.signals) < TOLERANCE);
        prop_assert!(relative(&theirs.weights, &ours.weights) < TOLERANCE);
        prop_assert!(relative(&theirs.splats.opacities, &ours.splats.opacities) < TOLERANCE);
        prop_assert!(relative(theirs.splats.means2d.as_flattened(), ours.splats.means2d.as_flattened()) < TOLERANCE);
        prop_assert!(relative(theirs.splats.conics.as_flattened(), ours.splats.conics.as_flattened()) < TOLERANCE);
    }
}

/// After two splats of maximum opacity, 10⁻⁴ of the light is left. Rounding then decides whether the second splat is
/// drawn, and kernel and brute force must round alike.
#[test]
fn coincident_splats_match_brute_force() {
    let (mut splats, plane) = splats(4, 3, 60, 30);
    for i in 0..4 {
        (splats.means2d[i], splats.radii[i]) = ([20.0, 12.0], 15.0);
        (splats.conics[i], splats.sigmas2d[i]) = ([0.04, 0.0, 0.04], [5.0, 5.0]);
        splats.opacities[i] = 1.0;
    }
    let signals = signals(4, 2, 9);
    let render = AlphaBlending::default().forward(splats.with_signals(&signals, 2, &plane));
    let (pixels, light) = reference::forward(&splats, &signals, 2, &plane);
    assert!(relative(&pixels, &render.pixels) < 1e-6 && relative(&light, &render.transmittance) < 1e-6);
}

#[test]
fn rendering_is_bit_identical_with_one_and_two_threads() {
    let (splats, plane) = splats(300, 5, 360, 90);
    let signals = signals(300, 2, 5);
    let run = |threads| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let raster = AlphaBlending::default();
            let render = raster.forward(splats.with_signals(&signals, 2, &plane));
            let d = raster.backward(splats.with_signals(&signals, 2, &plane), &render, &render.pixels);
            (render.pixels, d.splats, d.signals)
        })
    };
    assert_eq!(run(1), run(2));
}
