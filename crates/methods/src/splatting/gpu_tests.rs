//! Drawing on the GPU against that on the CPU, which has tests of its own: kernel by kernel, as a whole, slopes, bits.

use super::gpu::{Cotangents, view_constants};
use super::{Geometry, ReceiverView, Splatting};
use crate::groups::network_vjp;
use crate::{Activation, ActivationVjp, Readout};
use pwrfgs_core::plugin::Plugin;
use pwrfgs_core::ssim::Window;
use pwrfgs_core::testing::check_bits_in_another_process;
use pwrfgs_core::{
    Call, Deformation, DeformationInputs, Deltas, Elevation, GaussianCloud, ImagePlane, MeasurementSetup, Method,
    MethodVjp, Origin, Parameters, PixelSubset, Pose, Primitives, Projector, Rasterizer, Real, Receiver, SpectrumLoss,
    Splats, WantedInputs, rng, ssim,
};
use pwrfgs_gpu::draw::{
    CLOUD, D_IMAGE, D_PIXELS, D_ROWS, D_SPLATS, Drawing, GpuReadout, IMAGE, LOSS, LOSSES, PIXELS, SIGNALS, SPLATS,
    TERMS, TRUTHS, VIEW, WIDTHS,
};
use pwrfgs_gpu::{Gpu, GpuStep, for_tests};
use pwrfgs_raster::{AlphaBlending, Mercator};

pub(super) const COUNTS: [usize; 7] = [0, 1, 63, 64, 65, 157, 1000];
const SIZE: (usize, usize) = (90, 40); // no whole number of tiles

pub(super) fn random(name: &str, len: usize) -> Vec<Real> {
    let mut random = rng::stream(4, name, len as u64);
    (0..len).map(|_| rng::normal(&mut random)).collect()
}

pub(super) fn vectors<const W: usize>(name: &str, n: usize) -> Vec<[Real; W]> {
    random(name, W * n).as_chunks::<W>().0.to_vec()
}

/// Gaussians around the receiver, some of them out of view; gates and existence factors, some of them 0.
pub(super) fn cloud_of(n: usize) -> (GaussianCloud, Vec<Real>, Vec<Real>) {
    let mut cloud = GaussianCloud::zeros(n);
    cloud.means = vectors("means", n).iter().map(|[x, y, z]: &[Real; 3]| [2.0 * x, 2.0 * y, z + 1.2]).collect();
    cloud.log_scales = vectors("scales", n).iter().map(|s: &[Real; 3]| s.map(|s| 0.5 * s - 1.7)).collect();
    cloud.quats = vectors("quats", n);
    (cloud.opacity_logits, cloud.signals) = (random("logits", n), vectors("signals", n));
    let gate = (0..n).map(|i| 0.5 + 0.1 * (i % 6) as Real).collect();
    let existence = (0..n).map(|i| [1.0, 1.0, 0.0, 0.6][i % 4]).collect();
    (cloud, gate, existence)
}

fn terms_of(n: usize) -> Deltas {
    let scale = |v: Vec<[Real; 3]>, by: Real| v.iter().map(|v| v.map(|v| by * v)).collect();
    let quats = vectors("d quats", n).iter().map(|q: &[Real; 4]| q.map(|q| 0.1 * q)).collect();
    Deltas { scales: scale(vectors("d scales", n), 0.03), quats, signals: vectors("d signals", n) }
}

pub(super) fn setup() -> MeasurementSetup {
    let plane = ImagePlane::around(SIZE.0, SIZE.1, Elevation::UPPER);
    let pose = Pose { position: [0.1, -0.2, 0.3], ..Pose::IDENTITY };
    MeasurementSetup::spectra(Origin::default(), pose, plane)
}

fn view() -> ReceiverView {
    ReceiverView { pose: setup().pose(), plane: setup().plane }
}

fn shape(gaussians: usize, links: usize) -> Drawing {
    Drawing { gaussians, links, size: SIZE, channels: 2, readout: GpuReadout::Magnitude, has_terms: true }
}

fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|v| v * v).sum::<f64>().sqrt()
}

/// Compares by norm.
pub(super) fn compare(name: &str, found: &[Real], expected: &[Real], limit: f64) {
    assert_eq!(found.len(), expected.len(), "{name}");
    let size = norm(expected.iter().map(|&d| d.into()));
    let off = norm(found.iter().zip(expected).map(|(a, b)| f64::from(a - b)));
    assert!(off <= limit * size, "{name}: differs by {off:e} of {size:e}");
}

/// Compares number by number, relative to 1 or more.
fn compare_each(name: &str, found: &[Real], expected: &[Real], limit: Real) {
    assert_eq!(found.len(), expected.len(), "{name}");
    let off = |(a, b): (&Real, &Real)| (a - b).abs() / b.abs().max(1.0);
    let most = found.iter().zip(expected).map(off).fold(0.0, Real::max);
    assert!(most <= limit, "{name}: {most:e}");
}

/// Runs passes after uploads; returns `len` numbers of a slot.
fn run(
    gpu: &Gpu,
    sizes: &[usize],
    uploads: &[(usize, &[Real])],
    pass: impl Fn(&mut GpuStep<'_>),
    (slot, len): (usize, usize),
) -> Vec<Real> {
    let mut step = gpu.drawing_step(sizes).unwrap();
    uploads.iter().for_each(|(slot, values)| step.upload(*slot, 0, values));
    pass(&mut step);
    step.read(slot, 0, len);
    step.finish().unwrap().remove(0)
}

/// Rows of the slots of a cloud and of terms.
fn packed(n: usize) -> [Vec<Real>; 2] {
    let ((cloud, gate, existence), terms) = (cloud_of(n), terms_of(n));
    let (mut rows, mut of_terms) = (Vec::new(), Vec::new());
    for i in 0..n {
        rows.extend([cloud.means[i], cloud.log_scales[i]].concat());
        rows.extend([&cloud.quats[i][..], &[cloud.opacity_logits[i], gate[i], existence[i]]].concat());
        of_terms.extend([&terms.scales[i][..], &terms.quats[i]].concat());
    }
    [rows, of_terms]
}

fn geometry_of(n: usize) -> Geometry {
    let (cloud, gate, existence) = cloud_of(n);
    let (gate, existence) = (Some(&gate[..]), Some(&existence[..]));
    let p = Parameters { cloud: &cloud, gate, existence, weights: &[] };
    Splatting::default().geometry(&view(), &p, &terms_of(n), 0)
}

/// Columns of rows.
fn columns(rows: &[Real], width: usize, range: std::ops::Range<usize>) -> Vec<Real> {
    rows.chunks_exact(width).flat_map(|row| row[range.clone()].to_vec()).collect()
}

#[test]
fn splats_match() {
    let Some(gpu) = for_tests() else { return };
    let view_numbers = view_constants(&Mercator::default(), &view());
    for n in COUNTS {
        let [cloud, terms] = packed(n);
        let uploads: [(usize, &[Real]); 3] = [(CLOUD, &cloud), (TERMS, &terms), (VIEW, &view_numbers)];
        let shape = shape(n, 1);
        let (len, width) = (WIDTHS[2] * n, WIDTHS[2]);
        let found = run(gpu, &shape.sizes(None), &uploads, |step| shape.project(step), (SPLATS, len));
        let Splats { means2d, conics, opacities, existence, radii, .. } = geometry_of(n).splats;
        let drawn: Vec<usize> = (0..n).filter(|&i| radii[i] > 0.0).collect();
        let of = |range: std::ops::Range<usize>| {
            let all = columns(&found, width, range.clone());
            drawn.iter().flat_map(|i| all[i * range.len()..][..range.len()].to_vec()).collect::<Vec<_>>()
        };
        let expected = |column: &[Real], width: usize| {
            drawn.iter().flat_map(|i| column[i * width..][..width].to_vec()).collect::<Vec<_>>()
        };
        // Columns of up to 90 pixels: 1e-6 of their size is what single precision allows.
        compare_each("means", &of(0..2), &expected(means2d.as_flattened(), 2), 1e-6);
        // Conics are quotients of differences, so rounding grows with the ratio of the axes.
        compare("conics", &of(2..5), &expected(conics.as_flattened(), 3), 1e-5);
        compare_each("opacities", &of(5..6), &expected(&opacities, 1), 1e-6);
        compare_each("existence", &of(6..7), &expected(&existence, 1), 0.0);
        compare_each("radii", &columns(&found, width, 9..10), &radii, 1e-6);
    }
}

/// Splats of the CPU in depth order, as slot `SPLATS` has them, and their indices.
fn ordered_splats(splats: &Splats) -> (Vec<usize>, Vec<Real>) {
    let mut order: Vec<usize> = (0..splats.len()).collect();
    order.sort_by(|&a, &b| splats.depths[a].total_cmp(&splats.depths[b]));
    let mut rows = Vec::new();
    for &i in &order {
        rows.extend([&splats.means2d[i][..], &splats.conics[i], &[splats.opacities[i], splats.existence[i]]].concat());
        let reach = |sigma: Real| if splats.radii[i] > 0.0 { 4.0 * sigma + 1.0 } else { -1e9 };
        rows.extend([reach(splats.sigmas2d[i][0]), reach(splats.sigmas2d[i][1]), splats.radii[i], 0.0, 0.0]);
    }
    (order, rows)
}

fn sorted(values: &[Real], order: &[usize], width: usize) -> Vec<Real> {
    order.iter().flat_map(|i| values[i * width..][..width].to_vec()).collect()
}

#[test]
fn blending_matches_forward_and_backward() {
    let Some(gpu) = for_tests() else { return };
    let plane = setup().plane;
    for (n, links) in COUNTS.into_iter().flat_map(|n| [(n, 1), (n, 3)]) {
        let Geometry { splats, .. } = geometry_of(n);
        let ((order, rows), shape) = (ordered_splats(&splats), shape(n, links));
        let (images, signals) = (links * shape.pixels(), random("blended", 2 * links * n));
        let input = splats.with_signals(&signals, 2 * links, &plane);
        let render = AlphaBlending::default().forward(input);
        let of_order = sorted(&signals, &order, 2 * links);
        let uploads: [(usize, &[Real]); 2] = [(SPLATS, &rows), (SIGNALS, &of_order)];
        let numbers = 2 * images + shape.tiles();
        let found = run(gpu, &shape.sizes(None), &uploads, |step| shape.blend(step), (PIXELS, numbers));
        let (pixels, lengths) = found.split_at(2 * images);
        compare_each(&format!("{n} pixels"), pixels, &render.pixels, 1e-6);

        let d = random("d pixels", 2 * images);
        let vjp = AlphaBlending::default().backward(input, &render, &d);
        let mut d_pixels = Vec::new();
        for (d, pixels) in d.chunks_exact(2 * shape.pixels()).zip(render.pixels.chunks_exact(2 * shape.pixels())) {
            let product = |p: usize| -> Real { d[p] * pixels[p] + d[p + shape.pixels()] * pixels[p + shape.pixels()] };
            d_pixels.extend(d);
            d_pixels.extend((0..shape.pixels()).map(product));
        }
        let sizes = shape.sizes(Some(Drawing::entry_count(lengths).unwrap()));
        let uploads: [(usize, &[Real]); 3] = [(SPLATS, &rows), (SIGNALS, &of_order), (D_PIXELS, &d_pixels)];
        let width = shape.derivatives();
        let pass = |step: &mut GpuStep<'_>| {
            shape.blend(step);
            shape.blend_vjp(step);
        };
        let found = run(gpu, &sizes, &uploads, pass, (D_SPLATS, width * n));
        let Splats { means2d, conics, opacities, existence, .. } = vjp.splats;
        for (name, range, expected) in [
            ("means", 0..2, means2d.as_flattened()),
            ("conics", 2..5, conics.as_flattened()),
            ("opacities", 5..6, &opacities),
            ("weights", 6..7, &vjp.weights),
            ("existence", 7..8, &existence),
            ("signals", 8..width, &vjp.signals),
        ] {
            let expected = sorted(expected, &order, range.len());
            compare(&format!("{n}, {links}: d {name}"), &columns(&found, width, range), &expected, 1e-5);
        }
    }
}

#[test]
fn derivatives_of_the_geometry_match() {
    let Some(gpu) = for_tests() else { return };
    let view_numbers = view_constants(&Mercator::default(), &view());
    for n in COUNTS {
        let Geometry { primitives, splats, .. } = geometry_of(n);
        let [cloud, terms] = packed(n);
        let shape = shape(n, 1);
        let d = random("d splats", shape.derivatives() * n);
        let uploads: [(usize, &[Real]); 4] = [(CLOUD, &cloud), (TERMS, &terms), (VIEW, &view_numbers), (D_SPLATS, &d)];
        let sizes = shape.sizes(Some(1));
        let found = run(gpu, &sizes, &uploads, |step| shape.project_vjp(step), (D_ROWS, WIDTHS[3] * n));

        let mut d_splats = Splats::zeros(n);
        for (i, row) in d.chunks_exact(shape.derivatives()).enumerate() {
            d_splats.means2d[i].copy_from_slice(&row[..2]);
            d_splats.conics[i].copy_from_slice(&row[2..5]);
            d_splats.opacities[i] = row[5];
        }
        let d_primitives: Primitives =
            Mercator::default().project_vjp(&primitives, &view().pose, &view().plane, &splats, &d_splats);
        let ((cloud, gate, _), terms) = (cloud_of(n), terms_of(n));
        let mut sums = ActivationVjp::zeros(&cloud, &terms);
        let activation = Activation { channels: 2, ..Splatting::default().activation() };
        activation.geometry_vjp(&cloud, &terms, 0, Some(&gate), &d_primitives, &mut sums);
        let ActivationVjp { cloud, deltas, gate } = sums;
        for (name, range, expected) in [
            ("means", 0..3, cloud.means.as_flattened()),
            ("scales", 3..6, cloud.log_scales.as_flattened()),
            ("rotations", 6..10, cloud.quats.as_flattened()),
            ("logits", 10..11, &cloud.opacity_logits),
            ("gate", 11..12, &gate),
            ("scale terms", 12..15, deltas.scales.as_flattened()),
            ("rotation terms", 15..19, deltas.quats.as_flattened()),
        ] {
            compare(&format!("{n}: d {name}"), &columns(&found, WIDTHS[3], range), expected, 1e-5);
        }
        compare_each("radii", &columns(&found, WIDTHS[3], 19..20), &splats.radii, 0.0);
    }
}

#[test]
fn readouts_match() {
    let Some(gpu) = for_tests() else { return };
    for (readout, on_gpu) in [
        (Readout::Real, GpuReadout::Real),
        (Readout::Magnitude, GpuReadout::Magnitude),
        (Readout::Power, GpuReadout::Power),
        (Readout::MinMax, GpuReadout::MinMax),
    ] {
        for size in [SIZE, (9, 5)] {
            let shape = Drawing { readout: on_gpu, size, ..shape(0, 3) };
            let mut pixels = random("readout", 6 * shape.pixels());
            pixels[7] = 0.0; // a dark pixel, without derivative
            pixels[7 + shape.pixels()] = 0.0;
            let d = random("d values", 3 * shape.pixels());
            // The GPU has two channels always; `Real` reads the first.
            let channels = |images: &[Real]| -> Vec<Real> {
                let first = |pair: &[Real]| pair[..readout.channel_count() * shape.pixels()].to_vec();
                images.chunks_exact(2 * shape.pixels()).flat_map(first).collect()
            };
            let signals = channels(&pixels);
            let values = readout.forward(&signals, shape.pixels());
            let sizes = shape.sizes(Some(0));
            let uploads: [(usize, &[Real]); 2] = [(PIXELS, &pixels), (D_IMAGE, &d)];
            let found = run(gpu, &sizes, &uploads, |step| shape.read_out(step), (IMAGE, values.len()));
            compare_each("values", &found, &values, 1e-6);
            let expected = readout.vjp(&signals, shape.pixels(), &d);
            let len = 9 * shape.pixels();
            let found = run(gpu, &sizes, &uploads, |step| shape.read_out_vjp(step), (D_PIXELS, len));
            let (mut d_pixels, mut products): (Vec<Real>, Vec<Real>) = (Vec::new(), Vec::new());
            for planes in found.chunks_exact(3 * shape.pixels()) {
                d_pixels.extend(&planes[..2 * shape.pixels()]);
                products.extend(&planes[2 * shape.pixels()..]);
            }
            compare(&format!("d {readout:?}"), &channels(&d_pixels), &expected, 1e-6);
            for (at, product) in products.into_iter().enumerate() {
                let first = at / shape.pixels() * 2 * shape.pixels() + at % shape.pixels();
                let sum: Real = [first, first + shape.pixels()].map(|p| d_pixels[p] * pixels[p]).iter().sum();
                assert!((product - sum).abs() <= 1e-5 * sum.abs().max(1.0), "{product}, {sum}");
            }
        }
    }
}

/// Loss of predictions and its derivative on the CPU.
pub(super) fn loss_on_cpu(predictions: &[Real], loss: &SpectrumLoss<'_>, size: (usize, usize)) -> (Real, Vec<Real>) {
    let (&SpectrumLoss { truths, ssim_weight, window, is_squared }, len) = (loss, predictions.len() as Real);
    let (pixels, mut value, mut d) = (size.0 * size.1, 0.0_f64, Vec::new());
    for (p, t) in predictions.chunks(pixels).zip(truths.chunks(pixels)) {
        let (similarity, d_similarity) = ssim::training_form(p, t, size, &window);
        let share = pixels as Real / len;
        value += f64::from(ssim_weight * share * (1.0 - similarity));
        for ((p, t), d_similarity) in p.iter().zip(t).zip(d_similarity) {
            let error = p - t;
            let sign = if error == 0.0 { 0.0 } else { error.signum() };
            let (error, d_error) = if is_squared { (error * error, 2.0 * error) } else { (error.abs(), sign) };
            value += f64::from((1.0 - ssim_weight) / len * error);
            d.push((1.0 - ssim_weight) / len * d_error - ssim_weight * share * d_similarity);
        }
    }
    (value as Real, d)
}

#[test]
fn losses_match() {
    let Some(gpu) = for_tests() else { return };
    // Windows reach beyond the borders of small images.
    for (size, links) in [(SIZE, 1), (SIZE, 3), ((9, 5), 3), ((4, 30), 2)] {
        let shape = Drawing { size, ..shape(0, links) };
        let len = links * shape.pixels();
        let positive = |name| random(name, len).iter().map(|v| v.abs()).collect::<Vec<_>>();
        let (image, mut truths) = (positive("image"), positive("truths"));
        truths[3] = image[3]; // an error of 0
        for (ssim_weight, window, is_squared) in
            [(0.2, Window::default(), false), (0.7, Window::new(0.5), true), (0.0, Window::default(), true)]
        {
            let loss = SpectrumLoss { truths: &truths, ssim_weight, window, is_squared };
            let (expected, expected_d) = loss_on_cpu(&image, &loss, size);
            let shares = [(1.0 - ssim_weight) / len as Real, ssim_weight / len as Real];
            let constants = [&window.taps()[..], &shares].concat();
            let uploads: [(usize, &[Real]); 3] = [(IMAGE, &image), (TRUTHS, &truths), (LOSS, &constants)];
            let pass = |step: &mut GpuStep<'_>| shape.loss(step, is_squared, ssim_weight > 0.0);
            let read = |slot, len| run(gpu, &shape.sizes(Some(0)), &uploads, pass, (slot, len));
            compare("d loss", &read(D_IMAGE, len), &expected_d, 1e-6);
            let sums = read(LOSSES, 2 * links);
            let found: Real = sums.chunks_exact(2).map(|link| shares[0] * link[0] + shares[1] * link[1]).sum();
            compare_each("loss", &[found], &[expected], 1e-6);
        }
    }
}

/// A model with its inputs.
struct Case {
    method: Splatting,
    setup: MeasurementSetup,
    gaussians: usize,
    transmitters: usize,
    /// Column that moves.
    moved: &'static str,
    /// Weight of 1-SSIM in the loss, and whether its errors are squared; `None` for random cotangents.
    loss: Option<(Real, bool)>,
}

/// Observations, and derivatives with statistics, as one list each.
type Pass = [Vec<Real>; 2];

impl Case {
    fn new(deformation: &str, readout: Readout, gaussians: usize, transmitters: usize) -> Self {
        let deformation = Plugin::<dyn Deformation>::parse(deformation).unwrap();
        let method = Splatting { deformation, readout, ..Splatting::default() };
        Self { method, setup: setup(), gaussians, transmitters, moved: "signals", loss: None }
    }

    /// Runs a pass on the GPU, or the CPU, with a column moved by `shift` along a seeded direction; returns the slope along it
    /// too, and the norms of the derivative and of the direction multiplied, but for chance.
    fn run(&self, gpu: Option<&Gpu>, shift: Real) -> (Pass, [f64; 2]) {
        let Self { method, setup, gaussians, transmitters, moved, loss } = self;
        let (mut cloud, gate, existence) = cloud_of(*gaussians);
        let mut weights = method.layout(setup).init(&mut rng::stream(2, "weights", 0));
        let width = if *moved == "quats" { 4 } else { 2 };
        let direction = random("direction", width * gaussians);
        let columns = cloud.columns_mut().filter(|(name, ..)| name == moved);
        columns.flat_map(|(.., column)| column).zip(&direction).for_each(|(x, d)| *x += shift * d);
        weights.iter_mut().for_each(|w| *w *= 2.0);
        let positions = vectors::<3>("transmitters", *transmitters);
        let queries = positions
            .iter()
            .flat_map(|p| (0..setup.receivers.len()).map(|receiver| setup.query(p.map(f64::from), receiver)));
        let links = &setup.inputs(3, queries);
        let (gate, existence) = (Some(&gate[..]), Some(&existence[..]));
        let parameters = Parameters { cloud: &cloud, gate, existence, weights: &weights };
        let call = Call { setup, parameters, links, pixels: &PixelSubset::All };
        let mut sums = MethodVjp::zeros(&call, WantedInputs::default());
        let truths: Vec<Real> =
            random("truths", links.pairs.len() * setup.value_count()).iter().map(|t| t.abs()).collect();
        let loss = loss.map(|(ssim_weight, is_squared)| SpectrumLoss {
            truths: &truths,
            ssim_weight,
            window: Window::default(),
            is_squared,
        });
        let numbers = if let (Some(gpu), Some(loss)) = (gpu, &loss) {
            let (value, d) = method.gpu_loss_vjp(gpu, &call, loss);
            sums = d;
            vec![value]
        } else if let Some(gpu) = gpu {
            let (deltas, kept) = method.network_terms(&call, &None, true);
            let numbers = method.gpu_draw(gpu, &call, &deltas).unwrap();
            let mut grads = ActivationVjp::zeros(&cloud, &deltas);
            let d = random("d observations", numbers.len());
            let d = (&deltas, Cotangents::Given(&d));
            assert_eq!(method.gpu_draw_vjp(gpu, &call, d, &mut grads, &mut sums).unwrap(), 0.0);
            let (txs, pose) = (links.conditions(), setup.pose());
            let inputs = DeformationInputs { weights: &weights, means: &cloud.means, txs, pose: &pose, kept: &kept };
            network_vjp(&*method.deformation, &inputs, &grads, &mut sums);
            numbers
        } else {
            let observed = method.forward(&call, &None);
            let (numbers, d) = match &loss {
                Some(loss) => {
                    let (loss, d) = loss_on_cpu(&observed.numbers, loss, (setup.plane.width, setup.plane.height));
                    (vec![loss], d)
                }
                None => (observed.numbers.clone(), random("d observations", observed.numbers.len())),
            };
            method.vjp(&call, observed, &d, &mut sums);
            numbers
        };
        let along: Vec<Real> =
            sums.cloud.columns().filter(|(name, ..)| name == moved).flat_map(|(.., column)| column.to_vec()).collect();
        let slope = along.iter().zip(&direction).map(|(d, direction)| f64::from(d * direction)).sum();
        let size = norm(along.iter().map(|&d| d.into()));
        let mut d: Vec<Real> = sums.cloud.columns().flat_map(|(.., column)| column.to_vec()).collect();
        let statistics = &sums.stats;
        d.extend([&sums.gate, &sums.existence, &sums.weights, &statistics.visible].into_iter().flatten());
        d.extend([&statistics.gradient, &statistics.radius, &statistics.weight].into_iter().flatten());
        ([numbers, d], [slope, size])
    }
}

const NETWORK: &str = "Mlp(depth: 2, width: 16, skip: None, position_frequencies: 2, tx_frequencies: 2)";
const SHARED: &str = "Factored(depth: 1, width: 8)";

#[test]
fn whole_drawings_match() {
    let Some(gpu) = for_tests() else { return };
    let mut cases = Vec::new();
    for (n, transmitters) in COUNTS.into_iter().flat_map(|n| [(n, 1), (n, 3)]) {
        let readout = if transmitters == 1 { Readout::Magnitude } else { Readout::MinMax };
        cases.extend([NETWORK, SHARED].map(|network| Case::new(network, readout, n, transmitters)));
    }
    cases.extend([Readout::Real, Readout::Power].map(|readout| Case::new(SHARED, readout, 65, 2)));
    // Two receivers, and every third pixel.
    let mut several = Case::new(NETWORK, Readout::Magnitude, 65, 2);
    several.setup.receivers.push(Receiver::new("other", Pose { position: [0.5, 0.6, -0.1], ..Pose::IDENTITY }));
    let mut strided = Case::new(SHARED, Readout::Magnitude, 157, 2);
    strided.setup.plane = strided.setup.plane.strided(2, [1, 0]);
    cases.extend([several, strided]);
    // With the loss: many entries of lists, which need larger buffers than those of the cases before.
    for (network, gaussians, transmitters) in [(NETWORK, 0, 1), (NETWORK, 65, 3), (SHARED, 157, 3), (NETWORK, 1000, 1)]
    {
        cases.push(Case { loss: Some((0.2, false)), ..Case::new(network, Readout::MinMax, gaussians, transmitters) });
    }
    for case in cases {
        let name = format!("{} x {}, {:?}", case.gaussians, case.transmitters, case.loss);
        let ([expected, expected_d], _) = case.run(None, 0.0);
        let ([found, found_d], _) = case.run(Some(gpu), 0.0);
        // Centres differ by 1e-6 of the image, and the value of a pixel by as much as the slope of a Gaussian makes of it; a
        // pixel of many may change sides of the limit 1/255.
        let limit = if case.gaussians > 65 { 1e-3 } else { 1e-5 };
        compare(&format!("{name} values"), &found, &expected, limit);
        compare(&format!("{name} derivatives"), &found_d, &expected_d, limit);
        if case.gaussians == 157 {
            assert!(case.run(Some(gpu), 0.0).0 == [found, found_d], "{name}: equal bits");
        }
    }
}

#[test]
fn slopes_match_differences() {
    let Some(gpu) = for_tests() else { return };
    // Signals have no kink. A Gaussian that turns crosses the limit 1/255 in some pixels, which is no part of the derivative.
    let loss = Some((0.5, true));
    let cases = [("signals", 0.01, 2e-3, None), ("quats", 0.03, 0.05, None), ("signals", 0.01, 2e-3, loss)];
    for (moved, step, limit, loss) in cases {
        for (network, readout) in [(NETWORK, Readout::Magnitude), (SHARED, Readout::Power)] {
            let case = Case { moved, loss, ..Case::new(network, readout, 65, 2) };
            let value = |shift: Real| -> f64 {
                let numbers = &case.run(Some(gpu), shift).0[0];
                let d = if loss.is_some() { vec![1.0] } else { random("d observations", numbers.len()) };
                numbers.iter().zip(d).map(|(a, b)| f64::from(*a) * f64::from(b)).sum()
            };
            let difference = (value(step) - value(-step)) / f64::from(2.0 * step);
            let (_, [slope, size]) = case.run(Some(gpu), 0.0);
            println!("{moved}, {loss:?}: {slope} of {size}, by differences {difference}");
            assert!((slope - difference).abs() <= limit * size, "{slope} of {size}, by differences {difference}");
        }
    }
}

#[test]
fn bits_repeat_in_another_process() {
    let Some(gpu) = for_tests() else { return };
    let run = |loss| Case { loss, ..Case::new(NETWORK, Readout::MinMax, 157, 3) }.run(Some(gpu), 0.0).0.concat();
    let results = [None, Some((0.2, false))].map(run).concat();
    check_bits_in_another_process("splatting::gpu_tests::bits_repeat_in_another_process", results);
}

#[test]
fn parts_without_kernels_are_named() {
    let part = |text: &str| {
        let method = Plugin::<dyn Method>::parse(text).unwrap();
        let method: &dyn std::any::Any = method.get();
        method.downcast_ref::<Splatting>().unwrap().gpu_parts(&setup()).err()
    };
    assert_eq!(part("Splatting(readout: MinMax)"), None);
    for (text, expected) in [
        ("Splatting(projector: WrfgsCompat())", "projector WrfgsCompat"),
        ("Splatting(rasterizer: ArrayResponse())", "rasterizer ArrayResponse"),
        (
            "Splatting(rasterizer: AlphaBlending(support: TileSquares))",
            "rasterizer AlphaBlending(support: TileSquares)",
        ),
        ("Splatting(readout: ReceivedPower())", "readout ReceivedPower"),
        ("Splatting(calibration: AsReleased)", "calibration AsReleased"),
    ] {
        assert_eq!(part(text).as_deref(), Some(expected));
    }
}
