//! Tests of every deformation: derivatives, bit-identical results for any number of threads and any batch, correct
//! sizes.

use super::{Encoding, Factored, Fixed, Mlp, Near, Outputs, Wrfgs};
use pwrfgs_core::{
    Conditions, Deformation, DeformationInputs, DeformationVjp, Deltas, Plugin, Pose, Real, rng, testing::check_vjp,
};

pub(crate) const POSE: Pose = Pose { position: [0.5, -0.3, 0.2], orientation: [0.0, 0.0, 0.0, 1.0] };

pub(crate) fn points(n: usize, name: &str) -> Vec<[Real; 3]> {
    let mut random = rng::stream(11, name, 0);
    (0..n).map(|_| std::array::from_fn(|_| rng::normal(&mut random))).collect()
}

/// Concatenates all outputs into one vector.
fn flat(deltas: &Deltas) -> Vec<Real> {
    [deltas.quats.as_flattened(), deltas.scales.as_flattened(), deltas.signals.as_flattened()].concat()
}

/// Inverse of [`flat`], with the shape of `like`.
fn deltas_like(like: &Deltas, values: &[Real]) -> Deltas {
    let (quats, rest) = values.split_at(4 * like.quats.len());
    let (scales, signals) = rest.split_at(3 * like.scales.len());
    Deltas {
        quats: quats.as_chunks().0.to_vec(),
        scales: scales.as_chunks().0.to_vec(),
        signals: signals.as_chunks().0.to_vec(),
    }
}

/// Creates a cotangent for the output of `forward`.
fn cotangent(like: &Deltas) -> Deltas {
    let mut random = rng::stream(5, "cotangent", 0);
    let values: Vec<Real> = flat(like).iter().map(|_| rng::normal(&mut random)).collect();
    deltas_like(like, &values)
}

/// Compares with central differences along every weight, and along every position of the transmitters and every centre if
/// the deformation differentiates them.
fn check_derivative(name: &str, deformation: &dyn Deformation, n: usize, batch: usize, along_means: bool) {
    deformation.check().unwrap();
    let mut weights = deformation.layout().init(&mut rng::stream(2, name, 0));
    let width = deformation.traits().inputs;
    let conditions = |n: usize, name: &str| points(n * width, name).as_flattened()[..n * width].to_vec();
    deformation.start(Conditions::new(width, &conditions(5, "training")), &mut weights);
    let learned = deformation.layout().groups();
    let (means, txs) = (points(n, "means"), conditions(batch, "txs"));
    let carriers: Vec<Real> = txs.chunks_exact(width).map(|tx| tx[0]).collect();
    let along_txs = deformation.traits().differentiates_positions;
    assert_eq!(along_txs, width == 3, "{name}");
    let (sent, moved) = (if along_txs { &txs[..] } else { &[] }, if along_means { means.as_flattened() } else { &[] });
    let x = [weights.as_slice(), sent, moved].concat();
    let split = |x: &[Real]| {
        let (w, rest) = x.split_at(weights.len());
        let (sent, m) = rest.split_at(sent.len());
        let mut all = weights.clone();
        learned.iter().for_each(|group| all[group.range.clone()].copy_from_slice(&w[group.range.clone()]));
        (
            all,
            if along_txs { sent } else { &txs }.to_vec(),
            if along_means { m.as_chunks::<3>().0.to_vec() } else { means.clone() },
        )
    };
    let f = |x: &[Real]| {
        let (w, txs, means) = split(x);
        let txs = Conditions::new(width, &txs).at_carriers(&carriers);
        flat(&deformation.forward(&DeformationInputs::new(&w, &means, txs, &POSE), &None))
    };
    let vjp = |x: &[Real], d: &[Real]| {
        let (w, txs, means) = split(x);
        let inputs = DeformationInputs::new(&w, &means, Conditions::new(width, &txs).at_carriers(&carriers), &POSE);
        let d = deltas_like(&deformation.forward(&inputs, &None), d);
        // Starts from ones to show that derivatives are added.
        let (mut d_weights, mut d_means) = (vec![1.0; w.len()], vec![[1.0; 3]; n]);
        let mut d_txs = vec![[1.0; 3]; if along_txs { batch } else { 0 }];
        let (along_tx, along_mean) = (along_txs.then_some(&mut d_txs[..]), along_means.then_some(&mut d_means[..]));
        let sums = DeformationVjp { weights: &mut d_weights, means: along_mean, positions: along_tx };
        deformation.vjp(&inputs, &d, sums);
        // Derivatives that are not requested change no other.
        let (mut alone, mut alone_means) = (vec![1.0; w.len()], vec![[1.0; 3]; n]);
        let means = along_means.then_some(&mut alone_means[..]);
        deformation.vjp(&inputs, &d, DeformationVjp { weights: &mut alone, means, positions: None });
        assert!(alone == d_weights && alone_means == d_means, "{name}");
        d_weights.extend(d_txs.as_flattened());
        if along_means {
            d_weights.extend_from_slice(d_means.as_flattened());
        }
        d_weights.iter().map(|d| d - 1.0).collect()
    };
    check_vjp(name, &x, f, vjp, 1e-6, 2e-6);
}

fn small_mlp() -> Mlp {
    Mlp {
        depth: 4,
        width: 9,
        position_frequencies: 2,
        tx_frequencies: 1,
        tx_hidden: 6,
        tx_features: 5,
        skip: Some(1),
        ..Mlp::default()
    }
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn mlp_derivatives_agree_with_central_differences() {
    check_derivative("all outputs", &small_mlp(), 35, 3, false);
    check_derivative("no skip", &Mlp { skip: None, ..small_mlp() }, 5, 2, false);
    check_derivative("signals", &Mlp { outputs: Outputs::Signals, skip: Some(0), ..small_mlp() }, 20, 4, false);
    check_derivative("one layer", &Mlp { depth: 1, skip: None, ..small_mlp() }, 3, 1, false);
    check_derivative("carriers", &Mlp { carrier: 2.0, ..small_mlp() }, 5, 3, false);
    check_derivative("coordinates", &Mlp { position_frequencies: 0, tx_frequencies: 0, ..small_mlp() }, 3, 1, false);
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn wrfgs_derivatives_agree_with_central_differences() {
    let small = Wrfgs { depth: 4, width: 8, frequencies: 2, skip: Some(1), gain: None };
    check_derivative("wrfgs", &small, 35, 3, true);
    check_derivative("wrfgs, fixed gain", &Wrfgs { gain: Some(3.0), skip: None, ..small.clone() }, 5, 1, true);
    check_derivative("wrfgs, weights alone", &Wrfgs { depth: 1, skip: None, ..small }, 5, 2, false);
}

fn small_factored() -> Factored {
    Factored {
        depth: 3,
        width: 9,
        tx_encoding: Encoding::Octaves(2),
        position_encoding: Encoding::Octaves(1),
        near: None,
        carrier: 0.0,
    }
}

#[test]
#[cfg_attr(not(feature = "f64"), ignore = "needs double precision")]
fn factored_derivatives_agree_with_central_differences() {
    check_derivative("factored", &small_factored(), 7, 3, true);
    check_derivative("factored, carriers", &Factored { carrier: 2.0, ..small_factored() }, 2, 35, true);
    check_derivative("factored, two groups", &small_factored(), 2, 35, true);
    let bare = Factored { depth: 1, tx_encoding: Encoding::Octaves(0), ..small_factored() };
    check_derivative("factored, coordinates", &bare, 3, 1, true);
    let near = Some(Near { count: 6, length_m: 0.8 });
    check_derivative("factored, near", &Factored { near, ..small_factored() }, 4, 35, true);
    let features = Encoding::Features { width: 4, gain: 0.7 };
    check_derivative("factored, features", &Factored { tx_encoding: features, ..small_factored() }, 3, 2, true);
    let pseudo = Encoding::PseudoPosition { width: 5, gain: 0.7, octaves: 2 };
    check_derivative("factored, pseudo-positions", &Factored { tx_encoding: pseudo, ..small_factored() }, 3, 2, true);
    let lengths = Encoding::Wavelengths { count: 2, longest_m: 9.0, shortest_m: 2.0, seed: None };
    check_derivative("factored, wavelengths", &Factored { tx_encoding: lengths, ..small_factored() }, 3, 2, true);
    let waves = Encoding::Waves { count: 4, reach: 3.0, seed: 1 };
    check_derivative(
        "factored, waves",
        &Factored { tx_encoding: waves, position_encoding: waves, ..small_factored() },
        4,
        2,
        true,
    );
}

#[test]
fn networks_read_the_carrier_if_it_is_set() {
    let [deaf, hearing]: [[Box<dyn Deformation>; 2]; 2] = [0.0, 2.0].map(|carrier| {
        [
            Box::new(Mlp { carrier, ..small_mlp() }) as Box<dyn Deformation>,
            Box::new(Factored { carrier, ..small_factored() }),
        ]
    });
    let (means, txs) = (points(5, "means"), points(2, "txs"));
    for (deaf, hearing) in deaf.iter().zip(&hearing) {
        assert_eq!((deaf.traits().reads_carrier, hearing.traits().reads_carrier), (false, true));
        let run = |deformation: &dyn Deformation, carriers: &[Real]| {
            let weights = deformation.layout().init(&mut rng::stream(1, "init", 0));
            let txs = Conditions::from(&txs).at_carriers(carriers);
            flat(&deformation.forward(&DeformationInputs::new(&weights, &means, txs, &POSE), &None))
        };
        assert_eq!(run(&**deaf, &[-1.0, 1.0]), run(&**deaf, &[]));
        assert_ne!(run(&**hearing, &[-1.0, 1.0]), run(&**hearing, &[]));
        assert_eq!(run(&**hearing, &[0.0, 0.0]), run(&**hearing, &[]));
    }
    assert!(Factored { carrier: -1.0, ..small_factored() }.check().is_err());
}

#[test]
fn networks_have_published_sizes() {
    let count = |d: &dyn Deformation| d.layout().weight_count();
    assert_eq!(count(&Mlp::default()), 574_819);
    assert_eq!(count(&Wrfgs::default()), 189_636);
    assert_eq!(count(&Fixed::default()), 0);
    let mut names: Vec<String> = Mlp::default().layout().weights.into_iter().map(|spec| spec.name).collect();
    names.sort();
    names.dedup();
    assert_eq!(names.len(), Mlp::default().layout().weights.len());
}

#[test]
fn initial_weights_are_uniform_and_scaled_by_inputs() {
    let mlp = Mlp { head_init: 0.01, ..Mlp::default() };
    let weights = mlp.layout().init(&mut rng::stream(0, "init", 0));
    let mut rest = weights.as_slice();
    let mut inputs = std::collections::BTreeMap::new();
    for spec in mlp.layout().weights {
        let (these, after) = rest.split_at(spec.len());
        rest = after;
        let layer = spec.name.rsplit_once('.').unwrap().0.to_owned();
        let inputs = *inputs.entry(layer).or_insert_with(|| spec.shape[1]);
        let head = ["rotation", "scaling", "signal"].iter().any(|h| spec.name.starts_with(h));
        let bound = if head { 0.01 } else { 1.0 } / (inputs as Real).sqrt();
        let largest = these.iter().fold(0.0, |m: Real, w| m.max(w.abs()));
        assert!(largest <= bound && (these.len() < 50 || largest > 0.9 * bound), "{}: {largest}", spec.name);
    }
}

/// Returns deltas and all derivatives, with what the forward pass keeps, on a pool with this number of threads.
fn on_threads(threads: usize, deformation: &dyn Deformation, n: usize, batch: usize) -> (Deltas, Vec<Real>) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let mut weights = deformation.layout().init(&mut rng::stream(1, "init", 0));
    deformation.start((&points(60, "training")).into(), &mut weights);
    let (means, txs) = (points(n, "means"), points(batch, "txs"));
    pool.install(|| {
        let inputs = DeformationInputs::new(&weights, &means, &txs, &POSE);
        let (deltas, kept) = deformation.forward_for_vjp(&inputs);
        assert!(deltas == deformation.forward(&inputs, &None));
        let (mut again, inputs) = (vec![0.0; weights.len()], DeformationInputs { kept: &kept, ..inputs });
        let without = DeformationInputs { kept: &None, ..inputs };
        deformation.vjp(&without, &cotangent(&deltas), DeformationVjp::of_weights(&mut again));
        let (mut d_weights, mut d_means) = (vec![0.0; weights.len()], vec![[0.0; 3]; n]);
        let mut d_txs = vec![[0.0; 3]; batch];
        let (means, positions) = (Some(&mut d_means[..]), Some(&mut d_txs[..]));
        deformation.vjp(&inputs, &cotangent(&deltas), DeformationVjp { weights: &mut d_weights, means, positions });
        assert!(d_weights == again, "activations that are kept equal those computed again");
        d_weights.extend(d_txs.as_flattened());
        d_weights.extend_from_slice(d_means.as_flattened());
        (deltas, d_weights)
    })
}

#[test]
fn result_is_bit_identical_for_any_number_of_threads() {
    let mlp = Mlp { width: 128, ..Mlp::default() };
    let factored = Factored { near: Some(Near { count: 40, length_m: 0.5 }), ..Factored::default() };
    let deformations: [&dyn Deformation; 3] = [&mlp, &Wrfgs { width: 80, ..Wrfgs::default() }, &factored];
    for (n, batch) in [(157, 3), (1500, 2), (16, 70)] {
        for deformation in deformations {
            let expected = on_threads(1, deformation, n, batch);
            for threads in [2, 16, 64] {
                assert!(on_threads(threads, deformation, n, batch) == expected, "{threads}, {n}, {batch}");
            }
        }
    }
    // Long sums, which `gemm` divides, and a last chunk of few rows.
    let wide = Mlp { width: 600, depth: 2, skip: None, ..Mlp::default() };
    assert!(on_threads(64, &wide, 197, 1) == on_threads(1, &wide, 197, 1));
}

#[test]
fn batch_is_bit_identical_to_single_calls() {
    let mlp = Mlp { width: 64, depth: 6, ..Mlp::default() };
    let factored = Factored { near: Some(Near { count: 40, length_m: 0.5 }), ..Factored::default() };
    let deformations: [&dyn Deformation; 3] = [&mlp, &Wrfgs { width: 32, ..Wrfgs::default() }, &factored];
    let (means, txs) = (points(300, "means"), points(5, "txs"));
    for deformation in deformations {
        let weights = deformation.layout().init(&mut rng::stream(1, "init", 0));
        let inputs = |txs| DeformationInputs { weights: &weights, means: &means, txs, pose: &POSE, kept: &None };
        let batch = deformation.forward(&inputs((&txs).into()), &None);
        let d = cotangent(&batch);
        let mut d_batch = vec![0.0; weights.len()];
        deformation.vjp(&inputs((&txs).into()), &d, DeformationVjp::of_weights(&mut d_batch));
        let mut d_singles = vec![0.0; weights.len()];
        for (b, tx) in txs.chunks(1).enumerate() {
            let single = deformation.forward(&inputs(tx.into()), &None);
            let rows = b * means.len()..(b + 1) * means.len();
            let part = |d: &Deltas| Deltas {
                scales: d.scales.get(rows.clone()).unwrap_or_default().to_vec(),
                quats: d.quats.get(rows.clone()).unwrap_or_default().to_vec(),
                signals: d.signals[rows.clone()].to_vec(),
            };
            assert_eq!(single, part(&batch));
            deformation.vjp(&inputs(tx.into()), &part(&d), DeformationVjp::of_weights(&mut d_singles));
        }
        let largest = d_batch.iter().fold(0.0, |m: Real, d| m.max(d.abs()));
        for (a, b) in d_batch.iter().zip(&d_singles) {
            assert!((a - b).abs() <= 1e-4 * largest, "{a} {b}");
        }
    }
}

#[test]
fn accepts_zero_gaussians_and_zero_transmitters() {
    let wrfgs = Wrfgs { width: 8, ..Wrfgs::default() };
    let deformations: [&dyn Deformation; 4] = [&small_mlp(), &wrfgs, &small_factored(), &Fixed {}];
    for deformation in deformations {
        for (n, batch) in [(0, 2), (3, 0), (0, 0)] {
            let (deltas, d) = on_threads(1, deformation, n, batch);
            assert!(flat(&deltas).is_empty() && d.iter().all(|d| *d == 0.0));
        }
    }
}

#[test]
fn rejects_invalid_settings_and_defaults_round_trip() {
    for text in
        ["Mlp()", "Wrfgs()", "Factored()", "Fixed()", "Mlp(skip: 2, depth: 4, outputs: Signals)", "Wrfgs(gain: 12.5)"]
    {
        let plugin = Plugin::<dyn Deformation>::parse(text).unwrap();
        let pretty = ron::ser::PrettyConfig::new().struct_names(true);
        let written = pwrfgs_core::plugin::ron_options().to_string_pretty(&plugin, pretty).unwrap();
        let again = Plugin::<dyn Deformation>::parse(&written).unwrap();
        assert_eq!(format!("{plugin:?}"), format!("{again:?}"));
    }
    for (text, words) in [
        ("Mlp(depth: 0)", "give a number of layers"),
        ("Mlp(width: 0)", "width is 0"),
        ("Mlp(depth: 4)", "`skip: None`"),
        ("Mlp(depth: 5)", "`skip: None`"),
        ("Mlp(tx_hidden: 0)", "tx_hidden is 0"),
        ("Mlp(position_frequencies: 17)", "from 0 to 16"),
        ("Mlp(head_init: -1)", "not negative"),
        ("Mlp(head_init: NaN)", "not negative"),
        ("Wrfgs(width: 1, skip: None)", "at least 2"),
        ("Wrfgs(gain: 0)", "positive"),
        ("Mlp(widht: 3)", "widht"),
        ("Factored(depth: 0)", "give a number of layers"),
        ("Factored(position_encoding: Octaves(0))", "has no waves"),
        ("Factored(tx_encoding: Octaves(17))", "from 0 to 16"),
        ("Factored(tx_encoding: PseudoPosition(width: 4, octaves: 17))", "tx_encoding: octaves is 17; give a number"),
        ("Factored(tx_encoding: Features(width: 0))", "tx_encoding: width is 0; give a number from 1 to 8192"),
        ("Factored(tx_encoding: Features(width: 4, gain: 0))", "tx_encoding: gain is 0; give a finite number"),
        ("Factored(tx_encoding: Waves(count: 8, reach: 0))", "rad/m above 0"),
        ("Factored(near: (count: 0, length_m: 0.03))", "from 1 to 65536"),
        ("Factored(near: (count: 9, length_m: 0))", "metres above 0"),
        ("Factored(near: (count: 9, length_m: 0.1), tx_encoding: Features(width: 4))", "needs transmitter positions"),
    ] {
        let refusal = Plugin::<dyn Deformation>::parse(text).unwrap_err();
        assert!(refusal.contains(words), "{text}: {refusal}");
    }
}
