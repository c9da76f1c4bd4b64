//! Tests that the search finds the sources of a channel: positions, gains, rotated arrays; and that the result does not
//! depend on the number of threads.

use pwrfgs_core::{Real, rng};
use pwrfgs_methods::MatchingPursuit;
use pwrfgs_methods::virtual_transmitters::{
    ChannelInputs, PursuitOptions, VirtualSources, field, pursue_sources, snr_db,
};
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

static NEVER: AtomicBool = AtomicBool::new(false);

const IDENTITY: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

/// Returns positions in a room of 2 m, none close to a source, which would dominate the energy.
fn places(n: usize) -> Vec<[Real; 3]> {
    let mut random = rng::stream(7, "places", 0);
    (0..n).map(|_| [0.0, 1.0, 0.0].map(|first| first + 2.0 * rng::uniform(&mut random))).collect()
}

/// Creates a node, its images behind a wall and under the floor, and that of the corner.
fn truth(quats: [[f64; 4]; 4]) -> VirtualSources {
    let mut out = VirtualSources::default();
    for (k, (x, z)) in [(1.1, 1.4), (-1.3, 1.4), (1.1, -1.4), (-1.3, -1.4)].into_iter().enumerate() {
        out.push([x, 0.3, z], quats[k], [[1.0, 0.0], [-0.6, 0.3], [-0.5, 0.0], [0.3, -0.2]][k]);
    }
    out
}

fn settings() -> MatchingPursuit {
    MatchingPursuit { reach: 0.8, step: 0.35, most: 8, patience: 2, rounds: 0, ..MatchingPursuit::default() }
}

fn options() -> PursuitOptions {
    PursuitOptions { settings: settings(), rows: [256, 1024, 1024], peaks: 32, ..PursuitOptions::default() }
}

/// Returns the `each` = A·F gains of every position.
fn per_position(h: &[[Real; 2]], each: usize) -> Vec<&[[Real; 2]]> {
    h.chunks(each).collect()
}

fn nearest(found: &VirtualSources, v: [f64; 3]) -> f64 {
    let by = |p: &[f64; 3]| (0..3).map(|k| (p[k] - v[k]).powi(2)).sum::<f64>().sqrt();
    found.positions.iter().map(by).fold(f64::MAX, f64::min)
}

#[test]
#[cfg_attr(feature = "f64", ignore = "searched in single precision")]
fn finds_virtual_transmitters_of_room() {
    let (positions, truth) = (places(120), truth([IDENTITY; 4]));
    let links = ChannelInputs { positions: &positions, antennas: &[[0.0; 3]], frequencies: &[0.6e9] };
    let h = field(&truth.to_cloud(), None, &links);
    let (mut reports, stop) = (0, AtomicBool::new(false));
    let mut report_progress = |sources| {
        reports += 1;
        stop.store(sources >= 6.0, Relaxed);
    };
    let found = pursue_sources(&links, &per_position(&h, 1), &options(), &stop, &mut report_progress).unwrap();
    assert!(reports >= 4);
    for v in &truth.positions {
        assert!(nearest(&found, *v) < 0.02, "{v:?}: {found:?}");
    }
    assert!(snr_db(&field(&found.to_cloud(), None, &links), &h) > 30.0);
    let once = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let two = PursuitOptions { settings: MatchingPursuit { most: 2, ..settings() }, ..options() };
        let mut reports = vec![0.0];
        let found = pool.install(|| {
            pursue_sources(&links, &per_position(&h, 1), &two, &NEVER, &mut |done| reports.push(done)).unwrap()
        });
        assert!(reports.is_sorted() && reports.contains(&2.0), "additions: {reports:?}");
        let last = reports[reports.len() - 1];
        assert!(last > 2.0 && last <= two.settings.most_changes() as f64, "removals: {reports:?}");
        found
    };
    assert_eq!(once(1), once(3), "the same bits on any number of threads");
}

#[test]
fn most_changes_counts_removals_of_an_odd_number() {
    let settings = MatchingPursuit { most: 3, rounds: 0, ..MatchingPursuit::default() };
    assert_eq!(settings.most_changes(), 5, "three additions, and removals down to one source");
}

#[test]
#[cfg_attr(feature = "f64", ignore = "searched in single precision")]
fn finds_rotation_of_mirrored_array() {
    // A planar array on a wall y = const: its reflection in x equals a rotation about y, and so on.
    let (a, b) = ([0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]);
    let antennas: Vec<[Real; 3]> =
        (0..9).map(|k| [0.2 * ((k % 3) as Real) + 0.05, 0.0, 0.2 * ((k / 3) as Real)]).collect();
    // diag(-1, ·, 1) on x and z: half a turn about z; diag(1, ·, -1): about x; both: about y.
    let truth = truth([IDENTITY, b, [0.0, 1.0, 0.0, 0.0], a]);
    let positions = places(40);
    let links = ChannelInputs { positions: &positions, antennas: &antennas, frequencies: &[0.4e9, 0.43e9] };
    let h = field(&truth.to_cloud(), None, &links);
    let stop = AtomicBool::new(false);
    let h_of = per_position(&h, 18);
    let found =
        pursue_sources(&links, &h_of, &options(), &stop, &mut |sources| stop.store(sources >= 5.0, Relaxed)).unwrap();
    for v in &truth.positions {
        assert!(nearest(&found, *v) < 0.03, "{v:?}: {found:?}");
    }
    assert!(snr_db(&field(&found.to_cloud(), None, &links), &h) > 25.0);
}

/// Dipoles: gains that decrease with the squared cosine, and one visible from only half of the room.
#[test]
#[cfg_attr(feature = "f64", ignore = "searched in single precision")]
fn finds_direction_dependent_gains() {
    let positions = places(200);
    let mut truth = VirtualSources::new(2);
    for (place, gain) in [([1.1, 0.3, 1.4], [1.0, 0.0]), ([-1.3, 0.3, 1.4], [-0.6, 0.3])] {
        truth.push(place, IDENTITY, gain);
    }
    // 1 − y²: its harmonics are the mean and two of the second order.
    for g in 0..2 {
        let [x, y] = truth.gains[9 * g];
        truth.gains[9 * g + 6] = [0.4 * x, 0.4 * y];
        truth.gains[9 * g + 8] = [0.5 * x, 0.5 * y];
    }
    truth.gains[9 + 1] = [0.3, 0.1];
    let links = ChannelInputs { positions: &positions, antennas: &[[0.0; 3]], frequencies: &[0.6e9] };
    let h = field(&truth.to_cloud(), None, &links);
    let score = |order: usize| {
        let options = PursuitOptions { settings: MatchingPursuit { most: 2, ..settings() }, order, ..options() };
        let found = pursue_sources(&links, &per_position(&h, 1), &options, &NEVER, &mut |_| ()).unwrap();
        (snr_db(&field(&found.to_cloud(), None, &links), &h), found)
    };
    let ((flat, _), (directed, found)) = (score(0), score(2));
    assert!(directed > 30.0 && directed > flat + 10.0, "{directed} dB, and {flat} dB without directions");
    assert!(truth.positions.iter().all(|v| nearest(&found, *v) < 0.02), "{found:?}");
}

#[test]
#[cfg_attr(feature = "f64", ignore = "searched in single precision")]
fn reports_unsupported_search_input() {
    let positions = places(3);
    let links = ChannelInputs { positions: &positions, antennas: &[[0.0; 3]], frequencies: &[0.6e9] };
    let none = &mut |_| ();
    let changed = |settings| PursuitOptions { settings, ..options() };
    let h = [[1.0, 0.0]; 3];
    for (links, h, options, word) in [
        (links, &h[..2], options(), "2 complex numbers, expected 3"),
        (links, &[[0.0; 2]; 3][..], options(), "zero everywhere"),
        (links, &[[Real::NAN, 0.0]; 3][..], options(), "finite"),
        (ChannelInputs { frequencies: &[5.0], ..links }, &h[..], options(), "5 Hz"),
        (ChannelInputs { antennas: &[], ..links }, &[][..], options(), "0 antennas"),
        (links, &h[..], changed(MatchingPursuit { step: 0.0, ..settings() }), "`step`"),
        (links, &h[..], changed(MatchingPursuit { reach: -1.0, ..settings() }), "`reach`"),
        (links, &h[..], changed(MatchingPursuit { rounds: usize::MAX, ..settings() }), "`rounds`"),
        (links, &h[..], changed(MatchingPursuit { patience: usize::MAX, ..settings() }), "`patience`"),
        (links, &h[..], PursuitOptions { order: 4, ..options() }, "`order`"),
        (links, &h[..], PursuitOptions { peaks: 0, ..options() }, "`peaks`"),
    ] {
        let why = pursue_sources(&links, &per_position(h, 1), &options, &NEVER, none).unwrap_err();
        assert!(why.contains(word), "{why}");
    }
    assert!(
        pursue_sources(&links, &per_position(&h, 1), &options(), &NEVER, none).is_ok(),
        "three links are enough not to panic"
    );
}
