//! Pooled Kriging of invented powers.

use super::*;
use pwrfgs_core::{Baseline, Observations, Plugin, Pose, Receiver, Sample};

fn kriging() -> Plugin<dyn Baseline> {
    Plugin::<dyn Baseline>::parse("Kriging()").unwrap()
}

const RECEIVERS: [[f64; 3]; 3] = [[-3.0, 0.0, 2.0], [12.0, 3.0, 2.0], [4.0, -5.0, 2.0]];

/// Path loss of 20 dB per decade, offsets of 5 dB, and a wave of 3 dB.
fn true_power(receiver: usize, at: [f64; 3]) -> f64 {
    let wave = 3.0 * (at[0] + receiver as f64).sin();
    -40.0 - 5.0 * receiver as f64 - 20.0 * pwrfgs_core::kriging::log_distance(at, RECEIVERS[receiver]) + wave
}

/// Powers at 60 places of a grid.
fn powers_on_grid() -> Dataset {
    let place = |id: u32| [f64::from(id % 10), f64::from(id / 10), 0.0];
    let samples: Vec<Sample> =
        (0..60).flat_map(|id| (0..3).map(move |receiver| Sample { receiver, ..Sample::new(id, place(id)) })).collect();
    let powers = samples.iter().map(|s| true_power(s.receiver, s.position()) as Real).collect();
    let receiver =
        |(k, position): (usize, [f64; 3])| Receiver::new(["a", "b", "c"][k], Pose { position, ..Pose::IDENTITY });
    let receivers: Vec<Receiver> = RECEIVERS.into_iter().enumerate().map(receiver).collect();
    Dataset::of_links("grid", receivers, vec![], &samples, Observations::Powers(powers)).unwrap()
}

#[test]
fn receivers_share_process_and_path_loss() {
    let data = powers_on_grid();
    // One place in three is left out; of receiver c all.
    let known: Vec<usize> =
        (0..data.len()).filter(|&i| data.links[i].location % 3 != 1 && data.links[i].receiver < 2).collect();
    let fitted = kriging().fit(&data, FittingSet::train(&known)).unwrap();
    let error = |receiver: usize, x: f64| {
        let at = [x, 2.4, 0.0];
        (fitted.predict(Query::at(at, receiver)).pixels[0] as f64 - true_power(receiver, at)).abs()
    };
    assert!(error(0, 4.3) < 0.6 && error(1, 4.3) < 0.6, "{} and {}", error(0, 4.3), error(1, 4.3));
    // The offset of a receiver without links is unknown; its path loss is that of the others.
    let at = |x: f64| f64::from(fitted.predict(Query::at([x, 2.4, 0.0], 2)).pixels[0] as f32);
    let fall = (at(4.0) - at(80.0)) / (log(80.0) - log(4.0));
    assert!((5.0..28.0).contains(&fall), "{fall} dB per decade");
    let note = fitted.note().unwrap();
    assert!(note.contains("one correlation for all receivers, Matern 3/2 with") && note.contains("(a: -5"), "{note}");
    assert!(note.ends_with("; c has no training link and shares the mean path loss"), "{note}");
    // Without positions of receivers there is no path loss: the mean is constant.
    let mut data = data.clone();
    data.scene.receivers.iter_mut().for_each(|receiver| receiver.is_estimated = true);
    let fitted = kriging().fit(&data, FittingSet::train(&known)).unwrap();
    let far = [1e3, 1e6].map(|x| fitted.predict(Query::at([x, 0.0, 0.0], 0)).pixels[0]);
    assert_eq!(far[0], far[1]);
    assert!(fitted.note().unwrap().contains("mean in dBm (a: -"), "{:?}", fitted.note());
}

fn log(x: f64) -> f64 {
    pwrfgs_core::kriging::log_distance([x, 2.4, 0.0], RECEIVERS[2])
}

#[test]
fn process_without_links_keeps_its_fit() {
    let data = powers_on_grid();
    let all: Vec<usize> = (0..data.len()).collect();
    let (left_out, others): (Vec<usize>, Vec<usize>) = all.iter().partition(|i| data.links[**i].location < 20);
    let fitted = kriging().fit(&data, FittingSet::train(&all)).unwrap();
    let without = fitted.without(&left_out).unwrap();
    assert!(without.without(&others).is_none(), "no link is left");
    for &i in &left_out {
        let [with_it, without_it] = [&fitted, &without].map(|process| process.deviation(data.query(i)).unwrap());
        assert!(without_it > with_it, "{without_it} and {with_it}");
    }
    // Far from all links both are the same path-loss model.
    let far = Query::from([1e6, 0.0, 0.0]);
    assert_eq!(fitted.predict(far), without.predict(far));
    assert_eq!(fitted.deviation(far), without.deviation(far));
}
