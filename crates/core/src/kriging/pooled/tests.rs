//! Comparison with dense covariance matrices of all receivers (NumPy 2.3), and limits of the fit.

use super::marginal::log_likelihood;
use super::*;

/// Returns 16 powers at each of three receivers.
fn links() -> Vec<PowerLink> {
    let receivers = [[0.0, 0.0, 2.0], [5.0, 5.0, 2.0], [-4.0, 2.0, 2.0]];
    let link = |i: usize| {
        let (n, receiver) = (i as f64, i % 3);
        let r = receiver as f64;
        let place = [3.0 * (1.7 * n).sin() + 0.1 * n, 4.0 * (2.3 * n * n).cos(), 0.0, 0.0];
        let log = super::super::log_distance(position_of(place), receivers[receiver]);
        let fading = 4.0 * (place[0] + r).sin() + 2.0 * (1.3 * place[1]).cos() + 1.5 * (12.9898 * n).sin();
        let value = -50.0 + 5.0 * r - (20.0 + 2.0 * r) * log + fading;
        PowerLink { receiver, place, log_distance: Some(log), value }
    };
    (0..48).map(link).collect()
}

fn close(a: f64, b: f64) {
    assert!((a - b).abs() < 1e-6 * b.abs().max(1.0), "{a} instead of {b}");
}

#[test]
fn likelihood_trends_and_predictions_match_dense_covariances() {
    let expected = [
        (
            CorrelationKind::Exponential,
            0.545_401_949_020_870_8,
            [
                (-49.659_991_083_158_33, 21.863_371_852_865_527),
                (-43.547_348_784_124_27, 24.645_824_010_731_243),
                (-35.698_058_024_108_6, 28.503_525_449_339_64),
                (-43.413_200_148_089_04, 24.425_271_049_798_397),
            ],
            -61.655_891_361_262_775,
        ),
        (
            CorrelationKind::Matern32,
            -0.173_509_755_891_032_57,
            [
                (-49.876_536_014_377_96, 21.583_111_145_432_454),
                (-43.374_847_886_027_82, 24.801_169_801_642_484),
                (-36.306_797_204_291_43, 27.885_753_839_965_574),
                (-43.625_840_289_081_616, 24.183_441_139_050_817),
            ],
            -61.174_343_724_026_36,
        ),
        (
            CorrelationKind::LongTail,
            -0.641_999_642_919_302,
            [
                (-49.618_827_893_314_13, 21.823_678_356_056_575),
                (-43.925_135_281_589_32, 24.170_736_561_006_55),
                (-35.117_538_329_304_84, 29.080_063_717_751_216),
                (-43.333_603_240_549_92, 24.445_380_163_289_77),
            ],
            -61.858_940_946_531_45,
        ),
    ];
    let (links, at) = (links(), [1.0, 1.0, 0.0, 0.0]);
    let powers = Powers::new(&links, 4);
    for (kind, gain, laws, prediction) in expected {
        let correlation = Correlation { kind, scales: [2.0, 2.0, 2.0, f64::INFINITY], noise: 0.2 };
        let moments = powers.moments(&powers.cases, &correlation);
        close(log_likelihood(&moments, 9.0) - log_likelihood(&moments, 12.0), gain);
        let found: Vec<PathLoss> = trends(&moments, 9.0)
            .into_iter()
            .zip(&powers.by_receiver)
            .map(|(trend, own)| powers.path_loss(trend, own))
            .collect();
        for (law, (level, slope)) in found.iter().zip(laws) {
            close(law.level, level);
            close(law.slope, slope);
        }
        // Simple kriging about the posterior mean of the trend equals the joint prediction.
        let own: Vec<&PowerLink> = links.iter().filter(|link| link.receiver == 1).collect();
        let places: Vec<Place> = own.iter().map(|link| correlation.scaled(link.place)).collect();
        let weights = solve(&correlation, Mean::Zero, &places, correlation.scaled(at)).weights;
        let residual = |link: &PowerLink| link.value - found[1].power(link.log_distance.unwrap());
        let sum: f64 = own.iter().zip(weights).map(|(link, weight)| weight * residual(link)).sum();
        close(found[1].power(super::super::log_distance(position_of(at), [5.0, 5.0, 2.0])) + sum, prediction);
    }
}

#[test]
fn fit_tells_long_tails_from_exponentials() {
    let mut random = rng::stream(3, "places", 0);
    let places: Vec<Place> = (0..300)
        .map(|_| [60.0 * rng::uniform_f64(&mut random), 60.0 * rng::uniform_f64(&mut random), 0.0, 0.0])
        .collect();
    for kind in [CorrelationKind::Exponential, CorrelationKind::LongTail] {
        let correlation = Correlation { kind, scales: [6.0, 6.0, 6.0, f64::INFINITY], noise: 0.02 };
        let scaled: Vec<Place> = places.iter().map(|place| correlation.scaled(*place)).collect();
        let factor = super::super::factor_covariance(&correlation, &scaled).into_factor();
        let powers = |receiver: usize| {
            let draws: Vec<f64> = places.iter().map(|_| 5.0 * rng::normal_f64(&mut random)).collect();
            let value = |i: usize| -70.0 + (0..=i).map(|k| factor[i * places.len() + k] * draws[k]).sum::<f64>();
            let link = |i: usize| PowerLink { receiver, place: places[i], log_distance: None, value: value(i) };
            (0..places.len()).map(link).collect::<Vec<_>>()
        };
        let links: Vec<PowerLink> = (0..3).flat_map(powers).collect();
        assert_eq!(fit_pooled(&links, 3, &|| Ok(())).unwrap().correlation.kind, kind);
    }
}

#[test]
fn fit_accepts_few_equal_and_unplaced_powers() {
    let all = links();
    let unplaced: Vec<PowerLink> = all.iter().map(|link| PowerLink { log_distance: None, ..*link }).collect();
    let equal = vec![PowerLink { value: -70.0, place: [1.0; 4], ..all[0] }; 30];
    for links in [&all[..0], &all[..1], &all[..2], &all[..4], &all, &unplaced, &equal] {
        let PooledFit { path_losses: laws, correlation, variance } = fit_pooled(links, 4, &|| Ok(())).unwrap();
        assert_eq!(laws.len(), 4);
        let numbers = laws.iter().flat_map(|law| [law.level, law.slope]);
        assert!(
            numbers.chain(correlation.scales[..3].iter().copied()).chain([variance]).all(f64::is_finite),
            "{laws:?}"
        );
        assert!(links.iter().any(|link| link.log_distance.is_some()) || laws.iter().all(|law| law.slope == 0.0));
    }
    let error = fit_pooled(&all, 3, &|| Err(crate::Error::Config("stopped".into())));
    assert!(error.unwrap_err().to_string().contains("stopped"));
}
