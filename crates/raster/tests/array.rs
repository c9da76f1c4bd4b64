//! Tests of `ArrayResponse` against its definition, closed forms, central differences, and symmetries.

use crate::common::{POSE, primitives, relative, signals};
use pwrfgs_core::testing::check_vjp;
use pwrfgs_core::{ImagePlane, Mat3, Plugin, Pose, Primitives, Projector, Rasterizer, Real, Splats, Vec3};
use pwrfgs_raster::{ArrayResponse, Mercator, Wavefront, WrfgsCompat};
use std::f64::consts::TAU;

/// Number of Gaussians in the scene of the derivative test.
const N: usize = 9;
const CHANNELS: usize = 4;
const DOUBLE: bool = size_of::<Real>() == 8;

fn plane() -> ImagePlane {
    Mercator::default().plane(360, 90)
}

fn draw_on(array: &ArrayResponse, p: &Primitives, pose: &Pose, signals: &[Real], plane: &ImagePlane) -> Vec<Real> {
    let channels = signals.len() / p.len();
    array.forward(Mercator::default().project(p, pose, plane).with_signals(signals, channels, plane)).pixels
}

fn draw(array: &ArrayResponse, p: &Primitives, pose: &Pose, signals: &[Real]) -> Vec<Real> {
    draw_on(array, p, pose, signals, &plane())
}

/// Returns √(re² + im²) of the first transmitter.
fn magnitude(pixels: &[Real]) -> Vec<Real> {
    let (re, im) = pixels.split_at(pixels.len() / 2);
    re.iter().zip(im).map(|(re, im)| re.hypot(*im)).collect()
}

/// Creates point sources in these directions (degrees), `distance` metres from a receiver at the origin.
fn points(directions: &[(Real, Real)], distance: Real) -> Primitives {
    let mut p = Primitives::zeros(directions.len());
    for (i, &(az, el)) in directions.iter().enumerate() {
        p.means[i] = plane().direction(az, el).unwrap().map(|u| u * distance);
        p.scales[i] = [1e-4; 3];
        p.quats[i] = [1.0, 0.0, 0.0, 0.0];
        p.opacities[i] = 1.0;
    }
    p
}

/// Returns the antenna positions from the definition, wavelengths.
fn antennas(array: &ArrayResponse) -> Vec<[f64; 3]> {
    if !array.positions_wavelengths.is_empty() {
        return array.positions_wavelengths.iter().map(|p| p.map(f64::from)).collect();
    }
    let at = |i: usize, n: usize| (i as f64 - (n as f64 - 1.0) / 2.0) * f64::from(array.spacing_wavelengths);
    (0..array.rows * array.columns)
        .map(|k| [at(k % array.columns, array.columns), at(k / array.columns, array.rows), 0.0])
        .collect()
}

/// Creates arrays of given positions: a circle about its centre, an L, a line off the receiver, and a solid one.
fn given_arrays() -> [ArrayResponse; 4] {
    let circle = (0..8).map(|k| (k as Real) * TAU as Real / 8.0).map(|a| [0.6 * a.cos(), 0.6 * a.sin(), 0.0]);
    let circle: Vec<[Real; 3]> = circle.chain([[0.0; 3]]).collect();
    let ell = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 1.0, 0.0]];
    let line = [[2.0, 0.3, 0.0], [2.5, 0.3, 0.0]];
    let solid = [[0.4, 0.1, 0.3], [-0.4, -0.1, -0.3], [0.2, -0.5, 0.6], [0.0, 0.0, -0.7]];
    [circle, ell.to_vec(), line.to_vec(), solid.to_vec()].map(|positions_wavelengths| ArrayResponse {
        positions_wavelengths,
        widened: false,
        ..Default::default()
    })
}

/// Computes aᴴh/K at every pixel of `plane` for point sources, as interleaved complex numbers.
fn by_definition(array: &ArrayResponse, p: &Primitives, signals: &[Real], plane: &ImagePlane) -> Vec<Real> {
    let splats = Mercator::default().project(p, &Pose::IDENTITY, plane);
    let antennas = antennas(array);
    let (mut re, mut im) = (Vec::new(), Vec::new());
    for pixel in 0..plane.width * plane.height {
        let v = plane.direction((pixel % plane.width) as Real, (pixel / plane.width) as Real).unwrap();
        let (mut sum_re, mut sum_im) = (0.0, 0.0);
        for p_k in &antennas {
            for i in 0..p.len() {
                let [column, row] = splats.means2d[i];
                let u = plane.direction(column, row).unwrap();
                let along: f64 = (0..3).map(|i| p_k[i] * (f64::from(u[i]) - f64::from(v[i]))).sum();
                let phase = TAU * along;
                let o = f64::from(p.opacities[i]);
                let (s, t) = (f64::from(signals[2 * i]), f64::from(signals[2 * i + 1]));
                sum_re += o * (s * phase.cos() - t * phase.sin());
                sum_im += o * (s * phase.sin() + t * phase.cos());
            }
        }
        re.push((sum_re / antennas.len() as f64) as Real);
        im.push((sum_im / antennas.len() as f64) as Real);
    }
    [re, im].concat()
}

#[test]
fn array_image_matches_definition() {
    let p = points(&[(20.0, 15.0), (200.0, 50.0), (301.0, 80.0), (359.5, 3.0)], 3.0);
    let s = signals(4, 2, 1);
    // Even, odd, asymmetric, a single row, and images that do not fill the last block or have no opposite pixels.
    let grids = [(4, 4, 360, 90), (3, 3, 72, 18), (2, 5, 50, 11), (1, 8, 40, 9), (1, 1, 9, 4)];
    let grids = grids.map(|(rows, columns, width, height)| {
        (ArrayResponse { rows, columns, widened: false, ..ArrayResponse::default() }, width, height)
    });
    // Given positions with and without opposite antennas, in a plane and not.
    let given = given_arrays().into_iter().flat_map(|array| [(array.clone(), 72, 18), (array, 25, 7)]);
    for (array, width, height) in grids.into_iter().chain(given) {
        let plane = Mercator::default().plane(width, height);
        let found = draw_on(&array, &p, &Pose::IDENTITY, &s, &plane);
        let expected = by_definition(&array, &p, &s, &plane);
        let bound = if DOUBLE { 1e-7 } else { 1e-5 };
        assert!(relative(&expected, &found) < bound, "{array:?}: {}", relative(&expected, &found));
    }
}

#[test]
fn plane_wave_gives_array_factor() {
    let (az, el) = (130.0, 35.0);
    let array = ArrayResponse { rows: 3, columns: 5, spacing_wavelengths: 0.45, widened: false, ..Default::default() };
    let found = magnitude(&draw(&array, &points(&[(az, el)], 5.0), &Pose::IDENTITY, &[0.6, -0.8]));
    let u = plane().direction(az, el).unwrap();
    // |sin(N ψ/2) / (N sin(ψ/2))| along each axis.
    let factor = |count: usize, difference: f64| {
        let half = 0.5 * TAU * 0.45 * difference;
        if half.sin().abs() < 1e-9 { 1.0 } else { (count as f64 * half).sin() / (count as f64 * half.sin()) }
    };
    let expected: Vec<Real> = (0..found.len())
        .map(|pixel| {
            let v = plane().direction((pixel % 360) as Real, (pixel / 360) as Real).unwrap();
            let d = [0, 1].map(|k| f64::from(u[k]) - f64::from(v[k]));
            (factor(5, d[0]) * factor(3, d[1])).abs() as Real
        })
        .collect();
    assert!(relative(&expected, &found) < if DOUBLE { 1e-6 } else { 2e-5 }, "{}", relative(&expected, &found));
    assert!((found[35 * 360 + 130] - 1.0).abs() < 1e-5, "a wave of amplitude 1 is heard as 1 in its own direction");
}

#[test]
fn widened_response_is_mean_over_gaussian() {
    // Compares a ball at the zenith, at 45 degrees and near the horizon with points drawn from it. The first-order
    // error (the mean direction of a ball is shorter than that of its centre) is largest if u is in the plane of the
    // array.
    for (elevation, share) in [(89.5, 0.25), (45.0, 0.25), (12.0, 0.5)] {
        let mut ball = points(&[(70.0, elevation)], 4.0);
        ball.scales[0] = [0.5; 3];
        let wide = ArrayResponse::default();
        let found = draw(&wide, &ball, &Pose::IDENTITY, &[1.0, 0.0]);
        let mut random = pwrfgs_core::rng::stream(3, "ball", 0);
        let n = 20_000;
        let mut cloud = Primitives::zeros(n);
        for i in 0..n {
            cloud.means[i] = ball.means[0].map(|x| x + 0.5 * pwrfgs_core::rng::normal(&mut random));
            cloud.scales[i] = [1e-4; 3];
            cloud.quats[i] = [1.0, 0.0, 0.0, 0.0];
            cloud.opacities[i] = 1.0 / n as Real;
        }
        let signals: Vec<Real> = (0..n).flat_map(|_| [1.0, 0.0]).collect();
        let projector = Mercator { margin_deg: 60.0, ..Mercator::default() };
        let narrow = ArrayResponse { widened: false, ..ArrayResponse::default() };
        let expected =
            narrow.forward(projector.project(&cloud, &Pose::IDENTITY, &plane()).with_signals(&signals, 2, &plane()));
        let point = draw(&narrow, &ball, &Pose::IDENTITY, &[1.0, 0.0]);
        let (error, effect) = (relative(&expected.pixels, &found), relative(&expected.pixels, &point));
        assert!(effect > 0.05 && error < share * effect, "elevation {elevation}: error {error}, effect {effect}");
    }
}

#[test]
fn distant_spherical_waves_equal_plane_waves() {
    let directions = [(10.0, 20.0), (200.0, 70.0)];
    let spherical = Wavefront::Spherical { wavelength_m: 0.326 };
    let picture = |wavefront, distance| {
        let array = ArrayResponse { wavefront, widened: false, ..ArrayResponse::default() };
        draw(&array, &points(&directions, distance), &Pose::IDENTITY, &signals(2, 2, 8))
    };
    let differences = [1.0, 10.0, 100.0, 1000.0]
        .map(|distance| relative(&picture(Wavefront::Plane, distance), &picture(spherical, distance)));
    assert!(differences[0] > 0.05, "a metre away, fronts are bent: {differences:?}");
    assert!(differences.windows(2).all(|d| d[1] < 0.2 * d[0]), "bent as 1/distance: {differences:?}");
}

#[test]
fn spherical_wave_has_exact_phase_at_every_antenna() {
    // Two antennas: |aᴴh| of one source is |1 + exp(j(φ - ψ))|/2 with φ - ψ from the difference of the two path
    // lengths.
    let (wavelength, spacing) = (0.5, 0.7);
    let array = ArrayResponse {
        rows: 1,
        columns: 2,
        spacing_wavelengths: spacing,
        widened: false,
        wavefront: Wavefront::Spherical { wavelength_m: wavelength },
        ..ArrayResponse::default()
    };
    let p = points(&[(40.0, 25.0)], 0.9);
    let found = magnitude(&draw(&array, &p, &Pose::IDENTITY, &[1.0, 0.0]));
    let way = |x: Real| (Vec3::from_array(p.means[0]) - Vec3::new(x, 0.0, 0.0)).length();
    let half = 0.5 * spacing * wavelength;
    let phase = -(way(half) - way(-half)) / wavelength;
    for pixel in [0, 12_345, 29_000] {
        let v = plane().direction((pixel % 360) as Real, (pixel / 360) as Real).unwrap();
        let expected = (0.5 * TAU as Real * (phase - spacing * v[0])).cos().abs();
        assert!((found[pixel] - expected).abs() < 1e-4, "pixel {pixel}: {} is not {expected}", found[pixel]);
    }
}

#[test]
fn array_image_is_invariant_and_equivariant_under_rotation() {
    let n = 30;
    let p = primitives(n, 5);
    let s = signals(n, 2, 5);
    let array = ArrayResponse { wavefront: Wavefront::Spherical { wavelength_m: 0.3 }, ..ArrayResponse::default() };
    let still = magnitude(&draw(&array, &p, &POSE, &s));
    let turned_by = |q: glam::DQuat, with_receiver: bool| {
        let m = glam::DMat3::from_quat(q).to_cols_array().map(|v| v as Real);
        let m = Mat3::from_cols_array(&m);
        let mut turned = p.clone();
        for i in 0..n {
            turned.means[i] =
                (m * (Vec3::from_array(p.means[i]) - POSE.position_vec()) + POSE.position_vec()).to_array();
            let [w, x, y, z] = p.quats[i].map(|v| v as f64);
            let r = q * glam::DQuat::from_xyzw(x, y, z, w);
            turned.quats[i] = [r.w, r.x, r.y, r.z].map(|v| v as Real);
        }
        let [x, y, z, w] = POSE.orientation;
        let r = q * glam::DQuat::from_xyzw(x, y, z, w).normalize();
        let pose = Pose { orientation: if with_receiver { [r.x, r.y, r.z, r.w] } else { POSE.orientation }, ..POSE };
        magnitude(&draw(&array, &turned, &pose, &s))
    };
    let bound = if DOUBLE { 1e-9 } else { 2e-4 };
    let all = turned_by(glam::DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -1.1, 2.0), true);
    assert!(relative(&still, &all) < bound, "{}", relative(&still, &all));
    let boresight = POSE.world_from_receiver().z_axis.to_array().map(|v| v as f64);
    for quarter in 1..4 {
        let turn = glam::DQuat::from_axis_angle(boresight.into(), f64::from(quarter) * TAU / 4.0);
        let moved = turned_by(turn, false);
        let k = 90 * quarter as usize;
        let shifted: Vec<Real> = (0..moved.len()).map(|at| moved[at / 360 * 360 + (at % 360 + k) % 360]).collect();
        assert!(relative(&still, &shifted) < bound, "turn by {k}: {}", relative(&still, &shifted));
    }
}

#[test]
fn array_image_ignores_order_and_closed_gates() {
    let n = 50;
    let p = primitives(n, 2);
    let s = signals(n, 4, 2);
    let rows: Vec<usize> = (0..n).map(|i| i * 17 % n).collect();
    let select = |p: &Primitives, rows: &[usize]| Primitives {
        means: rows.iter().map(|&i| p.means[i]).collect(),
        scales: rows.iter().map(|&i| p.scales[i]).collect(),
        quats: rows.iter().map(|&i| p.quats[i]).collect(),
        opacities: rows.iter().map(|&i| p.opacities[i]).collect(),
    };
    let of = |rows: &[usize]| -> Vec<Real> { rows.iter().flat_map(|&i| s[4 * i..4 * i + 4].to_vec()).collect() };
    let array = ArrayResponse::default();
    let still = draw(&array, &p, &POSE, &s);
    let shuffled = draw(&array, &select(&p, &rows), &POSE, &of(&rows));
    assert!(relative(&still, &shuffled) < if DOUBLE { 1e-12 } else { 1e-5 });
    let mut closed = p.clone();
    (closed.opacities[7], closed.scales[7]) = (0.0, [0.0; 3]);
    let without: Vec<usize> = (0..n).filter(|&i| i != 7).collect();
    assert_eq!(draw(&array, &closed, &POSE, &s), draw(&array, &select(&p, &without), &POSE, &of(&without)));
}

#[test]
fn batched_transmitters_are_independent() {
    let p = primitives(20, 6);
    let s = signals(20, 6, 6);
    let array = ArrayResponse::default();
    let together = draw(&array, &p, &POSE, &s);
    let size = 360 * 90;
    for b in 0..3 {
        let own: Vec<Real> = s.chunks_exact(6).flat_map(|row| [row[2 * b], row[2 * b + 1]]).collect();
        assert_eq!(draw(&array, &p, &POSE, &own), together[2 * b * size..2 * (b + 1) * size]);
    }
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn derivatives_agree_with_differences() {
    let projector = Mercator::default();
    let plane = projector.plane(40, 13);
    let pack = |p: &Primitives, signals: &[Real]| {
        [p.means.as_flattened(), p.scales.as_flattened(), p.quats.as_flattened(), &p.opacities, signals].concat()
    };
    let unpack = |x: &[Real]| {
        let mut x = x.iter().copied();
        let mut p = Primitives::zeros(N);
        let mut fill = |v: &mut [Real]| v.iter_mut().for_each(|v| *v = x.next().unwrap());
        fill(p.means.as_flattened_mut());
        fill(p.scales.as_flattened_mut());
        fill(p.quats.as_flattened_mut());
        fill(&mut p.opacities);
        (p, x.collect::<Vec<Real>>())
    };
    let spherical = Wavefront::Spherical { wavelength_m: 0.7 };
    let settings = [(4, 4, true, Wavefront::Plane), (3, 5, false, Wavefront::Plane), (2, 3, true, spherical)];
    let grids = settings.map(|(rows, columns, widened, wavefront)| ArrayResponse {
        rows,
        columns,
        widened,
        wavefront,
        ..ArrayResponse::default()
    });
    let [circle, ell, line, solid] = given_arrays();
    let wide = |array: ArrayResponse, wavefront| ArrayResponse { widened: true, wavefront, ..array };
    let given = [wide(circle, spherical), wide(ell, Wavefront::Plane), line, wide(solid, spherical)];
    for (seed, array) in grids.into_iter().chain(given).enumerate() {
        let scene = primitives(N, seed as u64);
        check_vjp(
            "array response",
            &pack(&scene, &signals(N, CHANNELS, 7)),
            |x| {
                let (p, s) = unpack(x);
                draw_on(&array, &p, &POSE, &s, &plane)
            },
            |x, d| {
                let (p, s) = unpack(x);
                let splats = projector.project(&p, &POSE, &plane);
                let render = array.forward(splats.with_signals(&s, CHANNELS, &plane));
                let g = array.backward(splats.with_signals(&s, CHANNELS, &plane), &render, d);
                pack(&projector.project_vjp(&p, &POSE, &plane, &splats, &g.splats), &g.signals)
            },
            1e-6,
            1e-5,
        );
    }
}

#[test]
fn array_response_is_finite_for_degenerate_splats() {
    let plane = plane();
    let mut splats = Splats::zeros(3);
    splats.conics = vec![[0.0; 3], [1e-30, 0.0, 1e-30], [1e30, 0.0, 1e30]];
    splats.radii = vec![1.0; 3];
    splats.opacities = vec![1.0; 3];
    for wavefront in [Wavefront::Plane, Wavefront::Spherical { wavelength_m: 0.3 }] {
        let array = ArrayResponse { wavefront, ..ArrayResponse::default() };
        let render = array.forward(splats.with_signals(&[1.0; 6], 2, &plane));
        let g = array.backward(splats.with_signals(&[1.0; 6], 2, &plane), &render, &vec![1.0; render.pixels.len()]);
        let all = [render.pixels, g.signals, g.splats.means2d.into_flattened(), g.splats.conics.into_flattened()];
        assert!(all.iter().flatten().chain(&g.splats.depths).all(|x| x.is_finite()));
    }
    let none = ArrayResponse::default().forward(Splats::zeros(0).with_signals(&[], 2, &plane));
    assert!(none.pixels.iter().all(|p| *p == 0.0));
}

#[test]
fn rejects_unsupported_settings() {
    let refused = |text: &str| Plugin::<dyn Rasterizer>::parse(text).unwrap_err();
    assert!(refused("ArrayResponse(rows: 0)").contains("`rows` is 0"));
    assert!(refused("ArrayResponse(spacing_wavelengths: -1)").contains("spacing"));
    let twice = refused("ArrayResponse(positions_wavelengths: [(0.5, 0, 0), (0.5, 0, 0)])");
    assert!(twice.contains("antennas 1 and 2 are both at (0.5, 0, 0)"), "{twice}");
    let both = refused("ArrayResponse(rows: 2, positions_wavelengths: [(0.5, 0, 0)])");
    assert!(both.contains("give either the positions or the grid"), "{both}");
    assert!(refused("ArrayResponse(wavefront: Spherical(wavelength_m: 0))").contains("wavelength_m"));
    let compat = WrfgsCompat::default().plane(360, 90);
    assert!(ArrayResponse::default().check_plane(&compat).unwrap_err().to_string().contains("Mercator"));
}
