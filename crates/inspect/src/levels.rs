//! How strong powers and channels are: their range, and what receivers hear apart.

use pwrfgs_core::{Dataset, Observations};
use pwrfgs_experiment::scores::quantile;
use pwrfgs_experiment::text::number;

/// The middle and the tails of all links, dB, and how the receivers differ.
pub(crate) fn levels(data: &Dataset) -> Vec<(&'static str, String)> {
    let (name, unit, of): (_, _, Box<dyn Fn(usize) -> f64>) = match &data.observations {
        Observations::Channels(channels) => {
            let power = |link: usize| {
                let own = channels.of(link);
                let sum: f64 = own.iter().map(|[re, im]| f64::from(*re).powi(2) + f64::from(*im).powi(2)).sum();
                10.0 * (sum / own.len().max(1) as f64).log10()
            };
            ("mean |h|²", "dB", Box::new(power))
        }
        _ => ("powers", "dBm", Box::new(|link| f64::from(data.image(link).pixels[0]))),
    };
    let mut each: Vec<Vec<f64>> = vec![Vec::new(); data.scene.receivers.len()];
    for (link, at) in data.links.iter().enumerate() {
        let level = of(link);
        if level.is_finite() {
            each[at.receiver].push(level);
        }
    }
    let sorted = |mut all: Vec<f64>| {
        all.sort_by(f64::total_cmp);
        all
    };
    let all = sorted(each.concat());
    let [low, tenth, middle, last, high] = [0.0, 0.1, 0.5, 0.9, 1.0].map(|q| number(quantile(&all, q)));
    let range = format!("{middle} {unit} in the median ({tenth} to {last}, 10 % to 90 %; {low} to {high} in all)");
    let mut facts = vec![(name, range)];
    let named = data.scene.receivers.iter().zip(each).filter(|(_, own)| !own.is_empty());
    let mut receivers: Vec<(&str, usize, f64)> =
        named.map(|(receiver, own)| (receiver.name.as_str(), own.len(), quantile(&sorted(own), 0.5))).collect();
    receivers.sort_by(|a, b| b.2.total_cmp(&a.2));
    if let [(loud, loud_n, loudest), .., (quiet, quiet_n, quietest)] = &receivers[..] {
        let (loudest, quietest) = (number(*loudest), number(*quietest));
        let words = format!(
            "medians from {loudest} {unit} at {loud} ({loud_n} links) to {quietest} {unit} at {quiet} ({quiet_n} links)"
        );
        facts.push(("at receivers", words));
    }
    facts
}

#[cfg(test)]
mod tests {
    use super::*;
    use pwrfgs_core::{Pose, Receiver, Sample};

    #[test]
    fn medians_and_receivers_are_told() {
        let receivers = ["a", "b"].map(|name| Receiver::new(name, Pose::IDENTITY)).to_vec();
        let samples: Vec<Sample> = (0..6)
            .map(|k| Sample { id: k / 2, tx: [f64::from(k / 2), 0.0, 0.0], receiver: (k % 2) as usize })
            .collect();
        let powers = (0..6).map(|k| -50.0 - (k % 2) as pwrfgs_core::Real * 20.0 - k as pwrfgs_core::Real).collect();
        let data = Dataset::of_links("two", receivers, vec![], &samples[..], Observations::Powers(powers)).unwrap();
        let found = levels(&data);
        assert!(found[0].1.contains("dBm in the median") && found[0].1.contains("-75 to -50 in all"), "{found:?}");
        assert_eq!(found[1].1, "medians from -52 dBm at a (3 links) to -73 dBm at b (3 links)");
    }
}
