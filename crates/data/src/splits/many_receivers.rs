//! Splits of data with several receivers.

use super::testing::line_of_samples;
use super::*;
use crate::{NearestNeighbours, Neighbours};
use pwrfgs_core::{Baseline, Features, FittingSet, Observations, Plugin, Pose, Receiver, Sample, Split};

/// `count` transmitters a metre apart; receivers `a`, `b` and `c` receive each, except `c` for odd transmitters.
fn three_receivers(count: u32) -> Dataset {
    let receiver = |(name, x): (&str, f64)| Receiver::new(name, Pose { position: [x, 3.0, 0.0], ..Pose::IDENTITY });
    let links_of = |id: u32| (0..if id.is_multiple_of(2) { 3 } else { 2 }).map(move |receiver| (id, receiver));
    let samples: Vec<Sample> = (0..count)
        .flat_map(links_of)
        .map(|(id, receiver)| Sample { receiver, ..Sample::new(id, [f64::from(id), 0.0, 0.0]) })
        .collect();
    let powers =
        samples.iter().map(|s| -40.0 - 10.0 * s.receiver as pwrfgs_core::Real - s.id as pwrfgs_core::Real).collect();
    let receivers = [("a", 0.0), ("b", 5.0), ("c", 9.0)].map(receiver).to_vec();
    let data = Dataset::of_links("three", receivers, vec![], &samples, Observations::Powers(powers)).unwrap();
    let (test, train) = (0..data.len()).partition(|i| data.links[*i].location % 5 == 4);
    Dataset { official: Some((train, test)), ..data }
}

fn split(text: &str, data: &Dataset) -> Result<Partition, String> {
    let plugin = Plugin::<dyn Split>::parse(text).unwrap();
    plugin.split(data, &mut rng::stream(3, "split", 0)).map_err(|e| e.to_string())
}

#[test]
fn all_links_of_transmitter_are_in_one_set() {
    let data = three_receivers(40);
    for text in ["Official()", "Random()", "TimeBlock()", "Voxel(size_m: 3)", "Sparse(train: 20)"] {
        let parts = split(text, &data).unwrap();
        let locations = |links: &[usize]| data.locations_of(links);
        let lists = [locations(&parts.train), locations(&parts.validation), locations(&parts.test)];
        assert_eq!(lists.iter().map(Vec::len).sum::<usize>(), 40, "{text}");
        assert_eq!(parts.train.len() + parts.validation.len() + parts.test.len(), data.len(), "{text}");
        // As one receiver would have it.
        let alone = split(text, &line_of_samples(40)).unwrap();
        assert_eq!(lists, [alone.train, alone.validation, alone.test], "{text}");
    }
}

#[test]
fn random_links_split_links_of_transmitter() {
    let data = three_receivers(40);
    let parts = split("RandomLinks()", &data).unwrap();
    assert_eq!((parts.train.len(), parts.validation.len(), parts.test.len()), (72, 8, 20));
    let (train, test) = (data.locations_of(&parts.train), data.locations_of(&parts.test));
    assert!(test.iter().filter(|t| train.contains(t)).count() > 10);
    assert_eq!(split("RandomLinks()", &line_of_samples(40)), split("Random()", &line_of_samples(40)));
}

#[test]
fn held_out_receiver_is_test_set() {
    let data = three_receivers(40);
    let parts = split(r#"LeaveReceiverOut(receivers: ["c"])"#, &data).unwrap();
    assert!(parts.test.iter().all(|i| data.links[*i].receiver == 2) && parts.test.len() == 20);
    assert_eq!((parts.train.len(), parts.validation.len()), (72, 8));
    let with = split(r#"LeaveReceiverOut(receivers: ["c", "a"], calibration: 5, validation: 0)"#, &data).unwrap();
    let count = |links: &[usize], receiver| links.iter().filter(|i| data.links[**i].receiver == receiver).count();
    let counts = [0, 1, 2].map(|receiver| (count(&with.train, receiver), count(&with.test, receiver)));
    assert_eq!(counts, [(5, 35), (40, 0), (5, 15)]);
    let refused = [
        ("LeaveReceiverOut()", "name at least one of `receivers`; the receivers of three are `a`, `b`, `c`"),
        (r#"LeaveReceiverOut(receivers: ["d"])"#, "unknown receiver `d`"),
        (r#"LeaveReceiverOut(receivers: ["a", "b", "c"])"#, "no receiver is left to learn from"),
        (
            r#"LeaveReceiverOut(receivers: ["c"], calibration: 20)"#,
            "`c` has 20 links in all, which leaves no test link",
        ),
    ];
    for (text, message) in refused {
        let error = split(text, &data).unwrap_err();
        assert!(error.contains(message), "{error}");
    }
    assert!(Plugin::<dyn Split>::parse("RandomLinks(test: 1)").is_err());
    assert!(Plugin::<dyn Split>::parse("LeaveReceiverOut(validation: 1)").is_err());
}

#[test]
fn validation_does_not_change_the_test_set() {
    let data = three_receivers(40);
    let splits = [
        "Official(",
        "Random(",
        "RandomLinks(",
        "TimeBlock(",
        "Voxel(size_m: 3, ",
        "Sparse(train: 20, ",
        r#"LeaveReceiverOut(receivers: ["a", "c"], calibration: 5, "#,
    ];
    for text in splits {
        let test = |share: &str| split(&format!("{text}validation: {share})"), &data).unwrap().test;
        assert_eq!(test("0.0"), test("0.1"), "{text}");
        assert_eq!(test("0.0"), test("0.4"), "{text}");
    }
}

#[test]
fn baselines_are_fitted_per_receiver() {
    let data = three_receivers(40);
    let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-3, "{a} instead of {b}");
    let predict = |text: &str, fitting: FittingSet<'_>, i: usize| {
        let fitted = Plugin::<dyn Baseline>::parse(text).unwrap().fit(&data, fitting).unwrap();
        (fitted.predict(data.query(i)).pixels[0] as f64, fitted.note())
    };
    let links: Vec<usize> = (0..data.len()).collect();
    let first_of = |receiver: usize| data.links.iter().position(|link| link.receiver == receiver).unwrap();
    for (receiver, mean) in [(0, -59.5), (1, -69.5), (2, -79.0)] {
        close(predict("MeanSpectrum()", FittingSet::train(&links), first_of(receiver)).0, mean);
        close(
            predict("NearestNeighbours(k: 1)", FittingSet::train(&links), first_of(receiver)).0,
            -40.0 - 10.0 * receiver as f64,
        );
        assert!(predict("Kriging()", FittingSet::train(&links), first_of(receiver)).0.is_finite());
    }
    // A receiver without training links is predicted from all others.
    let fitting: Vec<usize> = links.iter().copied().filter(|i| data.links[*i].receiver < 2).collect();
    let (power, note) = predict("MeanSpectrum()", FittingSet::train(&fitting), first_of(2));
    close(power, -64.5);
    assert_eq!(note.unwrap(), "c has no training link and is predicted from those of all receivers");
    let (power, note) = predict("NearestNeighbours(k: Auto)", FittingSet::train(&fitting), first_of(2));
    close(power, -45.0);
    let note = note.unwrap();
    assert!(note.starts_with("k-NN uses k = ") && note.contains("best on held-out blocks; c has no"), "{note}");
    let note = predict("Kriging()", FittingSet::train(&fitting), first_of(2)).1.unwrap();
    assert!(
        note.contains("one correlation for all receivers") && note.contains("(a: ") && note.contains("; b: "),
        "{note}"
    );
    assert!(note.ends_with("; c has no training link and shares the mean path loss"), "{note}");
    assert!(
        predict("LogDistance(offset: true)", FittingSet::train(&fitting), first_of(2))
            .1
            .unwrap()
            .starts_with("c has too few")
    );
    assert_eq!(predict("LogDistance()", FittingSet::train(&fitting), first_of(2)).1, None);
    let mean = Plugin::<dyn Baseline>::parse("MeanSpectrum()").unwrap();
    let names = [pwrfgs_core::Task::Spectrum, data.task()].map(|kind| mean.name_for(kind));
    assert_eq!(names, ["mean spectrum", "mean of the receiver"]);
}

#[test]
fn neighbours_use_features_if_positions_are_unknown() {
    let mut data = three_receivers(10);
    data.placed = false;
    let links: Vec<usize> = (0..data.len()).collect();
    let nearest = NearestNeighbours { k: Neighbours::Number(1) };
    let fault = |baseline: &dyn Baseline, data: &Dataset| {
        baseline.fit(data, FittingSet::train(&links)).err().unwrap().to_string()
    };
    assert!(fault(&nearest, &data).contains("needs positions or features"));
    // Similar features have distant ids: transmitter t is similar to 9 - t.
    let feature = |i: &usize| {
        let t = data.links[*i].location as pwrfgs_core::Real;
        [(t - 4.5).abs(), 1.0]
    };
    let values = links.iter().flat_map(feature).collect();
    data.features = Some(Features { width: 2, values });
    let upper_half: Vec<usize> = links.iter().copied().filter(|i| data.links[*i].location >= 5).collect();
    let fitted = nearest.fit(&data, FittingSet::train(&upper_half)).unwrap();
    assert_eq!(fitted.predict(data.query(0)).pixels, [-49.0]);
    assert!(fault(&crate::Kriging::default(), &data).contains("use NearestNeighbours()"));
    assert!(fault(&crate::LogDistance::default(), &data).contains("needs transmitter positions"));
    assert!(fault(&crate::Zero {}, &data).contains("`Zero` does not support received powers"));
    assert!(
        fault(&crate::LogDistance::default(), &line_of_samples(30)).contains("`LogDistance` does not support spectra")
    );
}
