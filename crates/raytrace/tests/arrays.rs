//! Arrays of given element positions: channels and spectra by the plane-wave formula, and the page `docs/arrays.md`.

use glam::{DMat3, DQuat, DVec3};
use pwrfgs_core::{ImagePlane, Plugin, Pose, Primitives, Projector, Rasterizer, Real};
use pwrfgs_raster::{ArrayResponse, Mercator};
use pwrfgs_raytrace::array::Array;
use pwrfgs_raytrace::spectrum::Beamformer;
use pwrfgs_raytrace::{Complex, SPEED_OF_LIGHT, SceneFile, Simulator};
use std::f64::consts::TAU;
use std::path::Path;

/// A circle, an L that ends at the receiver, and a solid array; wavelengths.
fn given() -> [Vec<[f64; 3]>; 3] {
    let circle = (0..7).map(|k| TAU * f64::from(k) / 7.0).map(|a| [0.5 * a.cos(), 0.5 * a.sin(), 0.0]).collect();
    let ell = vec![[0.0; 3], [0.45, 0.0, 0.0], [0.9, 0.0, 0.0], [0.0, 0.45, 0.0], [0.0, 0.9, 0.0]];
    [circle, ell, vec![[0.3, 0.1, 0.2], [-0.3, 0.4, -0.1], [0.1, -0.5, 0.4], [0.0, 0.2, -0.6]]]
}

/// Returns an empty room with a receiver of this `array` on its ceiling; only the line of sight is traced.
fn room(receiver: &str) -> Simulator {
    let text = format!(
        "(name: \"room\", carrier_hz: 2.4e9,
          room: (outline: Box(low: (0, 0, 0), high: (8, 6, 3)), walls: (material: \"concrete\"),
              floor: (material: \"concrete\"), ceiling: (material: \"concrete\")),
          {receiver}
          transmitter: (positions: Uniform(low: (1, 1, 1), high: (7, 5, 1.5))),
          propagation: (order: 0, room_order: 0, diffraction: false))"
    );
    Simulator::new(&SceneFile::parse(&text, Path::new("room.ron")).unwrap_or_else(|e| panic!("{e}"))).unwrap()
}

#[test]
fn channel_of_given_positions_is_plane_wave() {
    let wavelength = SPEED_OF_LIGHT / 2.4e9;
    for positions in given() {
        let text = format!("{positions:?}").replace('[', "(").replace(']', ")");
        let list = format!("[{}]", &text[1..text.len() - 1]);
        let simulator = room(&format!(
            "receiver: (position: (4, 3, 2.5), orientation: Facing(direction: (0.3, 0, -1)), \
             array: (positions_wavelengths: {list}, wavefront: Plane)),"
        ));
        let receiver = &simulator.receivers()[0];
        let tx = DVec3::new(2.0, 4.5, 1.2);
        let paths = receiver.trace(tx);
        assert_eq!(paths.len(), 1, "the line of sight");
        let channel = receiver.channel(tx, &paths, &[2.4e9]);
        assert_eq!(channel.len(), positions.len());
        let turn = DMat3::from_quat(DQuat::from_array(receiver.pose().orientation));
        let u = turn.transpose() * (tx - DVec3::new(4.0, 3.0, 2.5)).normalize();
        for (h, p) in channel.iter().zip(&positions) {
            let wave = paths[0].baseband_gain(wavelength) * Complex::cis(TAU * DVec3::from(*p).dot(u));
            assert!((h / wave - 1.0).norm() < 1e-9, "{p:?}: {h} is not {wave}");
        }
    }
}

#[test]
fn simulator_and_rasterizer_agree_on_given_positions() {
    let (width, height) = (72, 18);
    let plane: ImagePlane = Mercator::default().plane(width, height);
    for positions in given() {
        let array = Array { positions_wavelengths: positions.clone(), ..Array::default() };
        let rasterizer = ArrayResponse {
            positions_wavelengths: positions.iter().map(|p| p.map(|v| v as Real)).collect(),
            widened: false,
            ..ArrayResponse::default()
        };
        let u = plane.direction(13.0, 7.0).unwrap();
        let mut source = Primitives::zeros(1);
        source.means[0] = u.map(|v| 4.0 * v);
        source.scales[0] = [1e-4; 3];
        source.quats[0] = [1.0, 0.0, 0.0, 0.0];
        source.opacities[0] = 1.0;
        let splats = Mercator::default().project(&source, &Pose::IDENTITY, &plane);
        let drawn = rasterizer.forward(splats.with_signals(&[0.6, -0.8], 2, &plane)).pixels;
        let u = DVec3::from(u.map(f64::from));
        let wave: Vec<Complex> = array.offsets(1.0).iter().map(|p| Complex::cis(TAU * p.dot(u))).collect();
        let simulated = Beamformer::new(&array, width, height).amplitude(&wave);
        let (re, im) = drawn.split_at(width * height);
        for (pixel, expected) in simulated.iter().enumerate() {
            let found = f64::from(re[pixel].hypot(im[pixel]));
            assert!((found - expected).abs() < 1e-4, "{positions:?}, pixel {pixel}: {found} is not {expected}");
        }
    }
}

#[test]
fn page_of_arrays_has_valid_examples() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap().join("docs/arrays.md");
    let page = std::fs::read_to_string(page).unwrap();
    let blocks: Vec<&str> =
        page.split("```ron\n").skip(1).map(|block| block.split("```").next().unwrap().trim()).collect();
    let [receiver, rasterizer] = blocks[..] else { panic!("{} blocks", blocks.len()) };
    let simulator = room(receiver);
    let rasterizer = rasterizer.trim_start_matches("rasterizer: ").trim_end_matches(',');
    let rasterizer = Plugin::<dyn Rasterizer>::parse(rasterizer).unwrap();
    let array = (rasterizer.get() as &dyn std::any::Any).downcast_ref::<ArrayResponse>().unwrap();
    let positions: Vec<[Real; 3]> =
        simulator.scene().receiver.array.offsets(1.0).iter().map(|p| p.to_array().map(|v| v as Real)).collect();
    assert_eq!(array.positions_wavelengths, positions);

    let axis = |name: &str| match name.split_at(1) {
        ("+", "x") => DVec3::X,
        ("-", "x") => DVec3::NEG_X,
        ("+", "y") => DVec3::Y,
        ("-", "y") => DVec3::NEG_Y,
        ("+", "z") => DVec3::Z,
        ("-", "z") => DVec3::NEG_Z,
        _ => panic!("{name} is no axis"),
    };
    let rows: Vec<Vec<&str>> = page
        .lines()
        .filter(|line| line.starts_with("| `0") || line.starts_with("| `1"))
        .map(|line| line.trim_matches(['|', ' ']).split(" | ").collect())
        .collect();
    assert_eq!(rows.len(), 4);
    for row in rows {
        let numbers: Vec<f64> = row[0].trim_matches('`').split(',').map(|v| v.parse().unwrap()).collect();
        let turn = DMat3::from_quat(DQuat::from_array(numbers.try_into().unwrap()));
        for (column, name) in [(turn.z_axis, row[1]), (turn.x_axis, row[2]), (turn.y_axis, row[3])] {
            assert!(column.abs_diff_eq(axis(name), 1e-12), "{}: {column} is not {name}", row[0]);
        }
        if let Some(facing) = row[4].split('`').find(|part| part.starts_with("Facing")) {
            let room = room(&format!("receiver: (position: (4, 3, 2.5), orientation: {facing}),"));
            let found = DMat3::from_quat(DQuat::from_array(room.receivers()[0].pose().orientation));
            assert!(found.abs_diff_eq(turn, 1e-12), "{facing} is not {}", row[0]);
        }
    }
}
