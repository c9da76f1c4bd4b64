//! Findings on data that are plausible but wrong, and none on right data.

use pwrfgs::experiment::{Finding, NoopObserver, check_findings, check_observed, collect_findings};
use pwrfgs_core::{Dataset, Pose, Real, Receiver, Sample, rng};

type Position = [f64; 3];

/// Transmitters at random in a hall of 20 x 12 m, in rows of a table.
fn hall() -> Vec<Position> {
    let mut random = rng::stream(7, "hall", 0);
    let mut within = |low: f64, high: f64| low + (high - low) * rng::uniform_f64(&mut random);
    (0..150).map(|_| [within(0.0, 20.0), within(0.0, 12.0), within(0.8, 1.6)]).collect()
}

const RECEIVERS: [Position; 4] = [[1.0, 1.0, 2.8], [19.0, 2.0, 2.9], [3.0, 11.0, 3.0], [16.0, 9.0, 2.7]];

/// Powers by a path-loss exponent of 3 and noise of 3 dB, a row per transmitter.
fn levels(positions: &[Position]) -> Vec<[f64; 4]> {
    let mut random = rng::stream(8, "hall", 0);
    let distance = |a: Position, b: Position| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
    let mut level =
        |at: Position, r: Position| -38.0 - 30.0 * distance(at, r).log10() + 3.0 * rng::normal_f64(&mut random);
    positions.iter().map(|at| RECEIVERS.map(|r| level(*at, r))).collect()
}

fn data(positions: &[Position], receivers: [Position; 4], levels: &[[f64; 4]]) -> Dataset {
    let row = |i: usize, at: Position| (0..4).map(move |receiver| Sample { receiver, ..Sample::new(i as u32, at) });
    let samples: Vec<Sample> = positions.iter().enumerate().flat_map(|(i, at)| row(i, *at)).collect();
    let powers: Vec<Real> = levels.iter().flatten().map(|v| *v as Real).collect();
    let named = |(name, at): (&str, Position)| Receiver::new(name, Pose { position: at, ..Pose::IDENTITY });
    let receivers = ["a", "b", "c", "d"].into_iter().zip(receivers).map(named).collect::<Vec<_>>();
    Dataset::of_links("hall", receivers, vec![], &samples, powers.into()).unwrap()
}

fn found(data: &Dataset) -> Vec<Finding> {
    collect_findings(data, None).unwrap()
}

/// Checks the only finding: its name, and words in its sentence.
#[track_caller]
fn expect(data: &Dataset, name: &str, words: &[&str]) -> Finding {
    let found = found(data);
    let [finding] = &found[..] else { panic!("{found:#?}") };
    let text = finding.to_string();
    assert!(finding.name == name && words.iter().all(|words| text.contains(words)), "{text}");
    finding.clone()
}

#[test]
fn right_data_have_no_finding() {
    let at = hall();
    assert_eq!(found(&data(&at, RECEIVERS, &levels(&at))), []);
    // Receivers with other gains.
    let gains = levels(&at).iter().map(|row| [row[0] + 15.0, row[1] - 15.0, row[2], row[3] - 5.0]).collect::<Vec<_>>();
    assert_eq!(found(&data(&at, RECEIVERS, &gains)), []);
    // The metre-frame of a campus, at a corner far from zero.
    let large = |p: Position| [4_000.0 + 150.0 * p[0], 9_000.0 + 150.0 * p[1], 12.0 * p[2]];
    let (wide, masts) = (at.iter().map(|p| large(*p)).collect::<Vec<_>>(), RECEIVERS.map(large));
    let weak: Vec<[f64; 4]> = levels(&at).iter().map(|row| row.map(|v| v - 50.0)).collect();
    assert_eq!(found(&data(&wide, masts, &weak)), []);
    // A walk along a corridor by whole metres.
    let walk: Vec<Position> = (0..60).map(|i| [f64::from(i), 1.0, 1.5]).collect();
    assert_eq!(found(&data(&walk, RECEIVERS, &levels(&walk))), []);
}

#[test]
fn finds_codes_with_count_distance_and_example() {
    let at = hall();
    for code in [0.0, 1.0, 100.0, -110.0, -200.0] {
        let heard = levels(&at).iter().map(|row| row.map(|v| if v < -75.0 { code } else { v })).collect::<Vec<_>>();
        let count = heard.iter().flatten().filter(|v| **v == code).count();
        let gap = heard.iter().flatten().filter(|v| **v != code).map(|v| (v - code).abs()).fold(f64::MAX, f64::min);
        let words = [
            format!("of 600 received powers, {count} are {code}, {gap:.1} dB from the next value"),
            format!("`--missing {code}`"),
            "(for example transmitter ".into(),
        ];
        let finding = expect(&data(&at, RECEIVERS, &heard), "lone-value", &words.each_ref().map(String::as_str));
        assert!(finding.is_error() && finding.count == count, "{finding:?}");
    }
}

#[test]
fn finds_a_power_that_many_links_share() {
    let at = hall();
    let clipped = levels(&at).iter().map(|row| row.map(|v| if v > -53.0 { -53.0 } else { v })).collect::<Vec<_>>();
    let finding = expect(&data(&at, RECEIVERS, &clipped), "shared-power", &["600 received powers are -53 dBm"]);
    assert!(!finding.is_error() && finding.count > 30, "{finding:?}");
}

#[test]
fn finds_units_of_powers() {
    let at = hall();
    let changed = |change: fn(f64) -> f64| {
        let levels: Vec<[f64; 4]> = levels(&at).iter().map(|row| row.map(change)).collect();
        data(&at, RECEIVERS, &levels)
    };
    let median = "median -68.1 dBm"; // of the powers in dBm
    for (change, words) in [
        ((|v| 10f64.powf(v / 10.0)) as fn(f64) -> f64, ["milliwatts, give 10 * log10(mW) (`--unit mW`", median]),
        (|v| 10f64.powf(v / 10.0 - 3.0), ["watts, give 10 * log10(W) + 30 (`--unit W`", median]),
        (|v| -v, ["the minus sign is missing), negate them", "`--unit positive-dBm`"]),
        (|v| (2.0 * (v + 100.0)).clamp(0.0, 100.0), ["per cent of quality, give value / 2 - 100", "`--unit percent`"]),
        (|v| v + 110.0, ["decibels over a floor, add the floor", "`--unit dB:-100`"]),
    ] {
        let finding = expect(&changed(change), "power-unit", &words);
        assert_eq!(finding.mend.contains("negate"), words[0].contains("negate"), "only one of both: {finding}");
    }
}

#[test]
fn finds_units_of_positions() {
    let at = hall();
    let tx = |change: fn(Position) -> Position| {
        let moved: Vec<Position> = at.iter().map(|p| change(*p)).collect();
        let found = found(&data(&moved, RECEIVERS, &levels(&at)));
        found.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
    };
    for (change, words) in [
        ((|p| p.map(|v| 1000.0 * v)) as fn(Position) -> Position, "in millimetres"),
        (|p| p.map(|v| 100.0 * v), "in centimetres"),
        (|p| p.map(|v| v / 0.3048), "in feet"),
        (|p| p.map(|v| v / 0.0254), "in inches"),
        (|p| p.map(|v| v / 1000.0), "if these are kilometres or degrees"),
        (|[x, y, z]| [48.0 + x / 111e3, 11.0 + y / 74e3, z], "x and y look like degrees: x 48.0000"),
        (|[x, y, z]| [11.0 + x / 74e3, 48.0 + y / 111e3, z], "x and y look like degrees"),
    ] {
        let text = tx(change);
        assert!(
            text.contains("position-unit: ") && text.contains(words) && text.contains("for example"),
            "{words}: {text}"
        );
    }
    // Both ends in millimetres: distances do not tell, but heights and levels do.
    let (mm, receivers) =
        (at.iter().map(|p| p.map(|v| 1000.0 * v)).collect::<Vec<_>>(), RECEIVERS.map(|p| p.map(|v| 1000.0 * v)));
    assert!(!expect(&data(&mm, receivers, &levels(&at)), "large-site", &["millimetres or centimetres"]).is_error());
    // Feet at both ends change the scale alone: nothing can tell.
    let feet = |p: Position| p.map(|v| v / 0.3048);
    assert_eq!(found(&data(&at.iter().map(|p| feet(*p)).collect::<Vec<_>>(), RECEIVERS.map(feet), &levels(&at))), []);
}

#[test]
fn finds_axes_rows_and_receivers_in_another_order() {
    let (at, levels) = (hall(), levels(&hall()));
    let with = |change: &dyn Fn(&mut Vec<Position>)| {
        let mut at = at.clone();
        change(&mut at);
        data(&at, RECEIVERS, &levels)
    };
    let swap = |a: usize, b: usize| move |at: &mut Vec<Position>| at.iter_mut().for_each(|p| p.swap(a, b));
    expect(&with(&swap(0, 1)), "axes", &["transmitters y, x, z (", "exchange x and y"]);
    expect(&with(&swap(0, 2)), "axes", &["exchange x and z"]);
    expect(&with(&swap(1, 2)), "axes", &["exchange y and z"]);
    expect(&with(&|at| at.reverse()), "row-order", &["the rows in reverse order"]);
    let shuffle = |at: &mut Vec<Position>| rng::shuffle(&mut rng::stream(1, "rows", 0), at);
    expect(&with(&shuffle), "row-order", &["neighbours are no more alike than of random pairs"]);
    expect(&with(&|at| at.rotate_right(1)), "row-order", &["no more alike"]);
    let columns = |order: [usize; 4]| {
        let levels: Vec<[f64; 4]> = levels.iter().map(|row| order.map(|k| row[k])).collect();
        data(&at, RECEIVERS, &levels)
    };
    expect(&columns([3, 2, 1, 0]), "receiver-order", &["in the order d, c, b, a (", "correct the header"]);
    expect(&columns([2, 0, 3, 1]), "receiver-order", &["in the order c, a, d, b ("]);
}

#[test]
fn finds_an_index_or_a_time_in_place_of_a_coordinate() {
    let at = hall();
    let levels = levels(&at);
    let index: Vec<Position> = at.iter().enumerate().map(|(i, p)| [i as f64, p[0], p[1]]).collect();
    expect(&data(&index, RECEIVERS, &levels), "index-coordinate", &["x rises by 1.000 from row to row"]);
    let time = |(i, p): (usize, &Position)| [p[0], 0.4 * i as f64 + if i % 3 == 0 { 0.05 } else { 0.0 }, p[1]];
    let time: Vec<Position> = at.iter().enumerate().map(time).collect();
    expect(&data(&time, RECEIVERS, &levels), "index-coordinate", &["y rises by 0.400"]);
    // A smooth walk, whose index is still a whole number.
    let walk: Vec<Position> = (0..150)
        .map(|i| [f64::from(i), 10.0 + 9.0 * (0.05 * f64::from(i)).sin(), 6.0 + 5.0 * (0.03 * f64::from(i)).cos()])
        .collect();
    let truth: Vec<Position> = walk.iter().map(|p| [p[1], p[2], 1.2]).collect();
    expect(&data(&walk, RECEIVERS, &self::levels(&truth)), "index-coordinate", &["x rises by 1.000"]);
}

#[test]
fn errors_come_at_once_and_names_accept_them() {
    let at = hall();
    let index: Vec<Position> = at.iter().enumerate().map(|(i, p)| [i as f64, p[0], p[1]]).collect();
    let coded = levels(&at).iter().map(|row| row.map(|v| if v < -75.0 { 100.0 } else { v })).collect::<Vec<_>>();
    let data = data(&index, RECEIVERS, &coded);
    let check = |accepted: &[&str]| {
        let accepted: Vec<String> = accepted.iter().map(|name| (*name).to_owned()).collect();
        check_findings(&data, None, Some(&accepted), &mut NoopObserver)
    };
    let refused = check(&[]).unwrap_err().to_string();
    for words in ["\n  index-coordinate: ", "\n  lone-value: ", "`--accept index-coordinate --accept lone-value`"] {
        assert!(refused.contains(words), "{refused}");
    }
    assert!(
        check(&["lone-value"]).unwrap_err().to_string().contains("`--accept index-coordinate --accept lone-value`")
    );
    assert_eq!(check(&["lone-value", "index-coordinate"]).unwrap().len(), 2);
    assert!(check(&["lone-valu"]).unwrap_err().to_string().contains("did you mean"));
    assert_eq!(check_findings(&data, None, None, &mut NoopObserver).unwrap().len(), 2);
}

#[test]
fn finds_observed_powers_far_from_known_ones() {
    let data = data(&hall(), RECEIVERS, &levels(&hall()));
    assert_eq!(check_observed(&data, &[-71.0, Real::NAN, -100.0]), None);
    let text = |observed: &[Real]| check_observed(&data, observed).unwrap().to_string();
    assert!(
        text(&[-71.0, 0.0, -80.0]).starts_with("lone-value: 1 powers are more than 20 dB from"),
        "{}",
        text(&[0.0])
    );
    assert!(text(&[2.1e-10, 5.1e-8]).contains("if these are watts, give 10 * log10(W) + 30"));
}
