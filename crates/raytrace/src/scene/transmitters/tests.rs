//! Positions are inside their box, in free space, and reproducible.

use super::*;

const LOW: [f64; 3] = [-0.893, -0.859, 0.809];
const HIGH: [f64; 3] = [0.724, 0.495, 1.701];

fn uniform_box() -> Transmitters {
    Transmitters::Uniform { low: LOW, high: HIGH }
}

fn walk() -> Transmitters {
    Transmitters::Walk { low: LOW, high: HIGH, step_m: 0.0104 }
}

fn grid(low: [f64; 3], high: [f64; 3], step_m: f64) -> Transmitters {
    Transmitters::Grid { low, high, step_m }
}

fn draw(transmitters: &Transmitters, count: usize, seed: u64) -> Vec<DVec3> {
    transmitters.draw(count, seed, &|_| Ok(())).unwrap()
}

/// Returns the error of a draw.
fn message(transmitters: &Transmitters, count: usize, free: &dyn Fn(DVec3) -> Result<(), String>) -> String {
    transmitters.draw(count, 0, free).unwrap_err().to_string()
}

#[test]
fn positions_are_in_box_and_file_is_exact() {
    let odd = [LOW.map(|v| v + 0.000_05), HIGH.map(|v| v - 0.000_03)];
    let [low, high] = odd;
    for transmitters in [
        uniform_box(),
        walk(),
        grid(LOW, HIGH, 0.2),
        Transmitters::Uniform { low, high },
        Transmitters::Walk { low, high, step_m: 0.3 },
        grid(low, high, 0.17),
    ] {
        let (low, high) = transmitters.corners();
        for position in draw(&transmitters, 150, 1) {
            for (k, value) in position.to_array().into_iter().enumerate() {
                assert!((low[k]..=high[k]).contains(&value), "{value} in {transmitters:?}");
                assert_eq!(format!("{value:.4}").parse::<f64>().unwrap(), value);
            }
        }
    }
}

#[test]
fn longer_draw_extends_shorter_draw_of_same_seed() {
    let without_corner = |p: DVec3| if p.x > 0.3 && p.y < 0.0 { Err("inside `shelf`".to_owned()) } else { Ok(()) };
    for transmitters in [uniform_box(), walk()] {
        let long = transmitters.draw(3000, 5, &without_corner).unwrap();
        let bits = |positions: &[DVec3]| positions.iter().map(|p| p.to_array().map(f64::to_bits)).collect::<Vec<_>>();
        for count in [0, 1, 100] {
            let short = transmitters.draw(count, 5, &without_corner).unwrap();
            assert_eq!(bits(&short), bits(&long[..count]));
        }
        assert!(long.iter().all(|p| without_corner(*p).is_ok()));
        assert_ne!(long[..100], transmitters.draw(100, 6, &without_corner).unwrap());
    }
}

#[test]
fn uniform_positions_fill_box_evenly() {
    let positions = draw(&uniform_box(), 8000, 2);
    let mut counts = [0.0; 8];
    for p in &positions {
        let is_high = |k: usize| usize::from(p[k] > f64::midpoint(LOW[k], HIGH[k]));
        counts[4 * is_high(0) + 2 * is_high(1) + is_high(2)] += 1.0;
    }
    // χ² with 7 degrees of freedom: above 24.3 once in a thousand.
    let chi: f64 = counts.iter().map(|n: &f64| (n - 1000.0).powi(2) / 1000.0).sum();
    assert!(chi < 24.3, "{chi}");
}

#[test]
fn grid_has_cube_centres_with_x_fastest() {
    let positions = draw(&grid([0.0, 0.0, 1.0], [3.0, 0.25, 1.0], 0.1), 60, 0);
    assert_eq!(positions[0], DVec3::new(0.05, 0.075, 1.0));
    assert_eq!(positions[1], DVec3::new(0.15, 0.075, 1.0));
    assert_eq!(positions[29], DVec3::new(2.95, 0.075, 1.0));
    assert_eq!(positions[30], DVec3::new(0.05, 0.175, 1.0));
    let thin = draw(&grid([1.0; 3], [1.5; 3], 0.8), 1, 0);
    assert_eq!(thin, [DVec3::splat(1.25)]);
}

#[test]
fn fewer_samples_are_ordered_subset_of_grid() {
    let grid = grid([0.0; 3], [1.0; 3], 0.1);
    let all = draw(&grid, 1000, 0);
    let some = draw(&grid, 100, 0);
    let indices: Vec<usize> = some.iter().map(|p| all.iter().position(|q| q == p).unwrap()).collect();
    assert!(indices.is_sorted_by(|a, b| a < b));
    // An even stride of ten would leave nine of ten columns empty.
    let columns: std::collections::BTreeSet<u64> = some.iter().map(|p| p.x.to_bits()).collect();
    assert_eq!(columns.len(), 10);
    assert_ne!(some, draw(&grid, 100, 1));
    let advice = "use a smaller `step_m`, a larger box or fewer samples";
    let expected = format!("transmitters: the grid has 1000 points, but 1001 samples are requested; {advice}");
    assert_eq!(message(&grid, 1001, &|_| Ok(())), expected);
}

#[test]
fn reports_grid_position_inside_object() {
    let free = |p: DVec3| if p.x > 0.5 { Err("inside `desk 2`".to_owned()) } else { Ok(()) };
    assert_eq!(
        message(&grid([0.0; 3], [1.0, 0.2, 0.1], 0.1), 20, &free),
        "transmitter 6 at (0.55, 0.05, 0.05) is inside `desk 2`; move the positions or the object"
    );
}

#[test]
fn reports_box_without_free_space() {
    let never = |_: DVec3| Err("inside `wardrobe`".to_owned());
    let advice = "move the box to where there is free space";
    let expected = "1000 positions in a row are not free, the last is inside `wardrobe`";
    for transmitters in [uniform_box(), walk()] {
        let expected = format!("transmitters: after 0 found, {expected}; {advice}");
        assert_eq!(message(&transmitters, 5, &never), expected);
        assert_eq!(transmitters.draw(0, 0, &never).unwrap(), []);
    }
    // One position is free, and the walk starts on it.
    let first = draw(&walk(), 1, 0)[0];
    let only = move |p: DVec3| if p == first { Ok(()) } else { never(p) };
    let message = message(&walk(), 2, &only);
    assert!(message.starts_with("transmitters: the walk cannot leave ("), "{message}");
    assert!(message.ends_with(&format!("1000 steps end where it is not free, the last inside `wardrobe`; {advice}")));
}

#[test]
fn walk_steps_and_turns_match_measured_walk() {
    let positions = draw(&walk(), 6123, 0);
    let steps: Vec<DVec3> = positions.windows(2).map(|w| w[1] - w[0]).collect();
    let mut lengths: Vec<f64> = steps.iter().map(|s| s.length()).collect();
    lengths.sort_by(f64::total_cmp);
    // Measured: 5.4, 10.4, 48 and 88 mm. Walls shorten some of the long ones.
    for (quantile, low, high) in
        [(0.05, 0.0050, 0.0058), (0.5, 0.0098, 0.0110), (0.9, 0.040, 0.055), (0.95, 0.075, 0.11)]
    {
        let length = lengths[(quantile * lengths.len() as f64) as usize];
        assert!((low..high).contains(&length), "quantile {quantile}: {length}");
    }
    // Measured: 0.59, 0.33, 0.25 and 0.09.
    for (lag, expected) in [(1, 0.59), (3, 0.33), (8, 0.25), (20, 0.09)] {
        let cosines = steps.iter().zip(&steps[lag..]).map(|(a, b)| a.normalize_or_zero().dot(b.normalize_or_zero()));
        let mean = cosines.sum::<f64>() / (steps.len() - lag) as f64;
        assert!((mean - expected).abs() < 0.06, "{lag} steps: {mean}");
    }
}

#[test]
fn walk_reaches_every_part_of_box() {
    for (low, high) in [(LOW, HIGH), ([0.0, 0.0, 1.0], [2.0, 1.0, 1.0])] {
        let positions = draw(&Transmitters::Walk { low, high, step_m: 0.02 }, 6000, 4);
        for k in 0..3 {
            let reached = positions.iter().fold((f64::MAX, f64::MIN), |(a, b), p| (a.min(p[k]), b.max(p[k])));
            let side = high[k] - low[k];
            assert!(reached.0 <= low[k] + 0.05 * side && reached.1 >= high[k] - 0.05 * side, "{reached:?}");
        }
    }
}

#[test]
fn reports_impossible_settings() {
    let at = |low: [f64; 3], high: [f64; 3]| Transmitters::Uniform { low, high };
    let walk = |step_m| Transmitters::Walk { low: [0.0; 3], high: [1.0; 3], step_m };
    let walk_advice = "give a length in metres from 0.001 to the longest side of the box, 1";
    let cases = [
        (at([0.0, 2.0, 0.0], [1.0; 3]), "y runs from 2 down to 1; swap `low` and `high`".to_owned()),
        (at([0.0; 3], [1.0, 1.0, f64::NAN]), "z runs from 0 to NaN; give `low` and `high` in metres".to_owned()),
        (at([0.0; 3], [1e9; 3]), "x runs from 0 to 1000000000; give `low` and `high` in metres".to_owned()),
        (
            at([0.000_01; 3], [0.000_09; 3]),
            "x runs from 0.00001 to 0.00009, which contains no multiple of 0.0001 m; use the same multiple for both"
                .to_owned(),
        ),
        (walk(0.0), format!("`step_m` of the walk is 0; {walk_advice}")),
        (walk(f64::NAN), format!("`step_m` of the walk is NaN; {walk_advice}")),
        (walk(1.5), format!("`step_m` of the walk is 1.5; {walk_advice}")),
        (grid([0.0; 3], [1.0; 3], 0.0), "`step_m` of the grid is 0; give a length of 0.0001 m or more".to_owned()),
        (
            grid([0.0; 3], [1.0; 3], 0.001),
            "the grid has 1000000000 points, more than ten million; use a larger `step_m`".to_owned(),
        ),
    ];
    for (transmitters, expected) in cases {
        assert_eq!(transmitters.check().unwrap_err(), expected);
        assert_eq!(message(&transmitters, 1, &|_| Ok(())), format!("transmitters: {expected}"));
    }
    assert!(at([1.0; 3], [1.0; 3]).check().is_ok(), "a point is a box");
}

#[test]
fn ron_output_equals_input() {
    let text = "Grid(low: (0, 0, 0.5), high: (1, 1, 1.5), step_m: 0.25)";
    let read: Transmitters = ron::from_str(text).unwrap();
    assert_eq!(read, grid([0.0, 0.0, 0.5], [1.0, 1.0, 1.5], 0.25));
    assert_eq!(ron::from_str::<Transmitters>(&ron::to_string(&read).unwrap()).unwrap(), read);
    assert!(ron::from_str::<Transmitters>("Uniform(low: (0, 0, 0), high: (1, 1, 1), step_m: 0.1)").is_err());
}
