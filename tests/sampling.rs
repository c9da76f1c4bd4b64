//! Strided image planes: their pixels and gradients are those of the whole image.

use crate::common::{built_in, cloud, pipeline, plugin, stages};
use pwrfgs::core::{
    AngleAxis, Call, Elevation, Link, LinkInputs, MeasurementSetup, MethodVjp, Origin, Parameters, PixelSubset,
    Projector, Rasterizer, Receiver, WantedInputs, rng,
};
use pwrfgs::methods::{Readout, Splatting};
use pwrfgs::model::Stages;
use pwrfgs::prelude::*;
use std::path::Path;

const STRIDE: usize = 3;

/// Narrow Gaussians and wide ones, drawn by every projector and rasterizer that accepts a stride.
fn every_way(mut check: impl FnMut(&str, &Stages)) {
    let mut checked = Vec::new();
    for projector in built_in::<dyn Projector>() {
        for rasterizer in built_in::<dyn Rasterizer>() {
            let way = format!("{projector} and {rasterizer}");
            let mut whole = stages("Fixed()", Readout::Magnitude).with(|splatting: &mut Splatting| {
                splatting.projector = plugin(&format!("{projector}()"));
                splatting.rasterizer = plugin(&format!("{rasterizer}()"));
            });
            whole.setup.plane = whole.settings::<Splatting>().unwrap().projector.plane(90, 24);
            let coarse = whole.setup.plane.strided(STRIDE, [0, 0]);
            let setup = MeasurementSetup { plane: coarse, ..whole.setup.clone() };
            if (Stages { setup, ..whole.clone() }).check().is_ok() {
                check(&way, &whole);
                checked.push(way);
            }
        }
    }
    assert!(checked.len() >= 3, "{checked:?}");
}

/// Gaussians, of which every second is narrower than a pixel.
fn narrow_and_wide() -> GaussianCloud {
    let mut cloud = cloud(60, 5);
    cloud.log_scales.iter_mut().step_by(2).for_each(|scales| *scales = [-4.5; 3]);
    cloud
}

fn draw(stages: &Stages, plane: &ImagePlane, cloud: &GaussianCloud) -> Vec<Real> {
    on_plane(stages, plane, cloud, |call| stages.method.forward(call, &None).numbers)
}

/// Calls the method for one link on `plane`.
fn on_plane<T>(stages: &Stages, plane: &ImagePlane, cloud: &GaussianCloud, run: impl FnOnce(&Call<'_>) -> T) -> T {
    let setup = MeasurementSetup { plane: plane.clone(), ..stages.setup.clone() };
    on_setup(&setup, cloud, &[], run)
}

fn on_setup<T>(
    setup: &MeasurementSetup,
    cloud: &GaussianCloud,
    weights: &[Real],
    run: impl FnOnce(&Call<'_>) -> T,
) -> T {
    let parameters = Parameters { cloud, gate: None, existence: None, weights };
    let links = vec![Link { location: 0, receiver: 0 }];
    let links = &LinkInputs { values: vec![0.1, 0.2, 0.3], pairs: links, ..LinkInputs::of(3, setup) };
    run(&Call { setup, parameters, links, pixels: &PixelSubset::All })
}

/// Where the pixels of a strided plane lie in the whole image.
fn places(plane: &ImagePlane, width: usize) -> impl Iterator<Item = usize> {
    let (columns, rows, [left, top]) = (plane.width, plane.height, plane.sampling.offset);
    (0..rows).flat_map(move |r| (0..columns).map(move |c| (top + STRIDE * r) * width + left + STRIDE * c))
}

#[test]
fn strided_image_keeps_pixels_of_whole_image() {
    let cloud = narrow_and_wide();
    let close = if size_of::<Real>() == 8 { 1e-11 } else { 2e-4 };
    every_way(|way, stages| {
        let whole = draw(stages, &stages.plane, &cloud);
        for offset in [[0, 0], [2, 1]] {
            let plane = stages.plane.strided(STRIDE, offset);
            let coarse = draw(stages, &plane, &cloud);
            let of_whole: Vec<Real> = places(&plane, stages.plane.width).map(|at| whole[at]).collect();
            assert!(of_whole.iter().any(|v| *v > 0.05), "{way}: there is something to see");
            for (i, (a, b)) in coarse.iter().zip(&of_whole).enumerate() {
                assert!((a - b).abs() < close, "{way}, offset {offset:?}, pixel {i}: {a} and {b}");
            }
        }
    });
}

#[test]
fn strided_gradient_equals_gradient_of_same_pixels() {
    let cloud = narrow_and_wide();
    let close = if size_of::<Real>() == 8 { 1e-9 } else { 5e-3 };
    every_way(|way, stages| {
        let plane = stages.plane.strided(STRIDE, [1, 2]);
        let random = &mut rng::stream(3, "cotangents", 0);
        let d: Vec<Real> = (0..plane.width * plane.height).map(|_| rng::normal(random)).collect();
        let mut d_whole = vec![0.0; stages.plane.width * stages.plane.height];
        places(&plane, stages.plane.width).zip(&d).for_each(|(at, d)| d_whole[at] = *d);
        let gradient = |plane: &ImagePlane, d: &[Real]| {
            on_plane(stages, plane, &cloud, |call| {
                let observed = stages.method.forward(call, &None);
                let mut sums = MethodVjp::zeros(call, WantedInputs::default());
                stages.method.vjp(call, observed, d, &mut sums);
                sums.cloud
            })
        };
        let (coarse, whole) = (gradient(&plane, &d), gradient(&stages.plane, &d_whole));
        for ((name, _, a), (_, _, b)) in coarse.columns().zip(whole.columns()) {
            let largest = b.iter().fold(1e-3, |m: Real, v| m.max(v.abs()));
            for (a, b) in a.iter().zip(b) {
                assert!((a - b).abs() < close * largest, "{way}, {name}: {a} and {b} of {largest}");
            }
        }
    });
}

#[test]
fn mean_strided_loss_equals_loss_of_whole_image() {
    let losses = |stride: usize, steps: usize| {
        let still: String = ["means", "log_scales", "quats", "opacity_logits", "signals", "network"]
            .map(|rate| format!("{rate}: Constant(0.0)"))
            .join(", ");
        let pipeline = pipeline(&format!(
            "data: Teacher(gaussians: 20, samples: 12, width: 36, height: 12), split: Random(test: 0.2), \
             initializer: Grid(count: 300, overlap: 0.2, opacity: 0.6), deformation: Fixed(), baselines: [], metrics: [Ssim()], \
             pruners: [], training: (steps: {steps}, batch: 9, stride: {stride}, densify_until: 0, prune_until: 0, \
             loss: (ssim_weight: 0.0), densify: (every: 0), optimizer: ({still}))"
        ));
        let data = pipeline.data.load(Path::new("."), &|_, _| {}).unwrap();
        let partition = pipeline.split.split(&data, &mut rng::stream(0, "split", 0)).unwrap();
        let mut trainer = pipeline.trainer(&data, &partition).unwrap();
        let mut losses: Vec<f64> = (0..steps).map(|_| trainer.step().unwrap().loss).collect();
        losses.sort_by(f64::total_cmp);
        losses.dedup_by(|a, b| (*a - *b).abs() < 1e-7);
        losses
    };
    let (whole, strided) = (losses(1, 2), losses(STRIDE, 90));
    assert_eq!((whole.len(), strided.len()), (1, 9), "every place of the stride is drawn: {strided:?}");
    let mean = strided.iter().sum::<f64>() / 9.0;
    assert!((mean - whole[0]).abs() < 1e-5, "{mean} in the mean of {strided:?}, {} of all pixels", whole[0]);
}

/// Which half of 2,000 Gaussians, most of them narrower than the stride, a prune step keeps.
fn kept(training: &str) -> Vec<u32> {
    let still: String = ["means", "log_scales", "quats", "opacity_logits", "signals", "network"]
        .map(|rate| format!("{rate}: Constant(0.0)"))
        .join(", ");
    let pipeline = pipeline(&format!(
        "data: Teacher(gaussians: 20, samples: 1000, width: 36, height: 12), split: Random(test: 0.1), \
         initializer: Random(count: 2000, std: 2.0, nearest: 1, opacity: 0.6), deformation: Fixed(), baselines: [], metrics: [Ssim()], \
         pruners: [MiniSplatting(rule: Cumulated(0.99))], training: (steps: 2, target_count: 1000, batch: 1, densify_until: 0, prune_until: 2, \
         prune_every: 2, densify: (every: 0), optimizer: ({still}), {training})"
    ));
    let data = pipeline.data.load(Path::new("."), &|_, _| {}).unwrap();
    let partition = pipeline.split.split(&data, &mut rng::stream(0, "split", 0)).unwrap();
    let mut trainer = pipeline.trainer(&data, &partition).unwrap();
    (0..2).for_each(|_| drop(trainer.step().unwrap()));
    trainer.gaussian_ids().to_vec()
}

#[test]
fn strided_prune_step_keeps_same_gaussians() {
    let whole = kept("stride: 1");
    for training in ["stride: 3", "stride: 3, moving_stride: false"] {
        let common = kept(training).iter().filter(|id| whole.contains(id)).count();
        println!("{training}: {common} of 1,000 Gaussians kept are those of the whole image");
        assert!(common >= 950, "{training}: {common} of 1,000"); // at one place for all parts: 817
    }
}

#[test]
fn whole_tiles_reject_stride() {
    let mut whole = stages("Fixed()", Readout::Magnitude).with(|splatting: &mut Splatting| {
        splatting.projector = plugin("WrfgsCompat()");
        splatting.rasterizer = plugin("AlphaBlending(support: TileSquares)");
    });
    whole.setup.plane = ImagePlane { wraps: false, angles: None, ..whole.setup.plane.clone() };
    whole.check().unwrap();
    whole.setup.plane = whole.setup.plane.strided(STRIDE, [0, 0]);
    assert!(whole.check().unwrap_err().contains("training.stride: 1"));
}

#[test]
fn strided_plane_recovers_whole_plane() {
    let axis = |first, step| AngleAxis { first, step };
    let plane = stages("Fixed()", Readout::Magnitude).plane.clone();
    let strided = plane.strided(STRIDE, [2, 1]);
    assert_eq!(strided.angles, Some((axis(8.0, 12.0), axis(3.75, 11.25))));
    assert_eq!(*strided.whole(), plane);
    assert_eq!(plane.elevation(), Some(Elevation::UPPER));
}

/// The power of one Gaussian at an elevation, on a sky of so many degrees per pixel.
fn power(elevation_deg: Real, sky_deg: u32) -> Real {
    let readout = Readout::ReceivedPower { sky_deg, filter_deg2: 270.0 };
    let base = stages("Fixed()", Readout::Magnitude).with(|splatting: &mut Splatting| splatting.readout = readout);
    let plane = ImagePlane::plain(1, 1);
    let receivers = vec![Receiver::new("gateway", Pose::IDENTITY)];
    let setup = MeasurementSetup {
        plane,
        task: pwrfgs::core::Task::Power,
        receivers,
        ..MeasurementSetup::spectra(Origin::ZERO, Pose::IDENTITY, base.setup.plane.clone())
    };
    let (sin, cos) = elevation_deg.to_radians().sin_cos();
    let cloud = GaussianCloud {
        means: vec![[4.0 * cos, 0.0, 4.0 * sin]],
        log_scales: vec![[-2.0; 3]],
        quats: vec![[1.0, 0.0, 0.0, 0.0]],
        opacity_logits: vec![0.0],
        signals: vec![[1.0, 0.0]],
        ..GaussianCloud::default()
    };
    on_setup(&setup, &cloud, &[0.0, 0.0], |call| base.method.forward(call, &None).numbers[0])
}

#[test]
fn power_sky_covers_sphere_at_any_resolution() {
    for sky_deg in [6, 10, 30] {
        let base = stages("Fixed()", Readout::Magnitude).with(|splatting: &mut Splatting| {
            splatting.readout = Readout::ReceivedPower { sky_deg, filter_deg2: 30.0 }
        });
        let sky = base.settings::<Splatting>().unwrap().sky(&base.setup);
        let last = sky.azimuth_elevation_deg(0.0, sky.height as Real - 1.0).unwrap().1;
        assert_eq!((sky.height, last), (180 / sky_deg as usize + 1, 90.0), "the poles have rows");
    }
    for elevation in [5.0, 40.0, 88.0] {
        let [fine, usual, coarse] = [5, 10, 30].map(|sky_deg| power(elevation, sky_deg));
        println!("{elevation} degrees: {fine} dB at 5, {usual} at 10, {coarse} at 30");
        assert!((fine - usual).abs() < 0.3 && (fine - coarse).abs() < 1.5, "{elevation}: {fine} {usual} {coarse}");
    }
}
