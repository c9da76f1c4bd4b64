//! Baselines of received powers on measured data (BLE of NeRF2), compared with reference values.

use super::*;
use crate::{LeaveReceiverOut, Nerf2Rssi, Official, Voxel};
use pwrfgs_core::testing::shared;
use pwrfgs_core::{DataSource, Partition, Split, rng};
use rayon::prelude::*;

fn ble() -> Option<Dataset> {
    let root = shared("data/ble")?;
    Some(Nerf2Rssi { root, ..Nerf2Rssi::default() }.load(".".as_ref(), &|_, _| {}).unwrap())
}

/// Median and mean of the absolute error over test links, dB.
fn errors(data: &Dataset, partition: &Partition, baseline: &dyn Baseline) -> [f64; 2] {
    let start = std::time::Instant::now();
    let fitted = baseline.fit(data, partition.known()).unwrap();
    let error = |&i: &usize| {
        let error = fitted.predict(data.query(i)).pixels[0] - data.image(i).pixels[0];
        f64::from(error.abs() as f32)
    };
    let mut all: Vec<f64> = partition.test.par_iter().map(error).collect();
    all.sort_by(f64::total_cmp);
    let found = [all[all.len() / 2], all.iter().sum::<f64>() / all.len() as f64];
    let name = baseline.name_for(data.task());
    println!("{name}: {:.2} / {:.2} dB, {:.1} s", found[0], found[1], start.elapsed().as_secs_f64());
    fitted.note().into_iter().for_each(|note| println!("    {note}"));
    found
}

fn neighbours(k: usize) -> NearestNeighbours {
    NearestNeighbours { k: k.into() }
}

fn own_laws() -> LogDistance {
    LogDistance { per_receiver: true, offset: false }
}

/// Every baseline reproduces its reference value within `by`.
fn hold(data: &Dataset, partition: &Partition, expected: &[(&dyn Baseline, [f64; 2])], by: f64) {
    for (baseline, known) in expected {
        let found = errors(data, partition, *baseline);
        for (found, known) in found.iter().zip(known) {
            assert!((found - known).abs() <= by, "{}: {found} instead of {known}", baseline.name());
        }
    }
}

#[test]
fn official_power_split_reproduces_published_baselines() {
    let Some(data) = ble() else { return };
    assert_eq!((data.locations.len(), data.scene.receivers.len(), data.len()), (4800, 21, 33_600));
    let partition = Official::default().split(&data, &mut rng::stream(0, "split", 0)).unwrap();
    assert_eq!(partition.test.len(), 960 * 7);
    let expected: [(&dyn Baseline, [f64; 2]); 7] = [
        (&MeanSpectrum {}, [7.75, 8.90]),
        (&LogDistance::default(), [6.95, 8.16]),
        (&own_laws(), [6.32, 7.70]),
        (&neighbours(1), [3.20, 4.09]),
        (&neighbours(5), [2.80, 3.47]),
        (&neighbours(15), [2.87, 3.55]),
        (&Kriging::default(), [2.79, 3.45]),
    ];
    hold(&data, &partition, &expected, 0.03);
    errors(&data, &partition, &NearestNeighbours { k: Neighbours::Auto });
    errors(&data, &partition, &LogDistance { per_receiver: false, offset: true });
}

#[test]
fn held_out_cells_approximate_published_power_baselines() {
    let Some(data) = ble() else { return };
    // Results depend on the drawn cells: this draw has about the nearest neighbours of the reference.
    let voxel = Voxel { size_m: 2.0, ..Voxel::default() };
    let partition = voxel.split(&data, &mut rng::stream(1, "split", 0)).unwrap();
    let other: [(&dyn Baseline, [f64; 2]); 3] =
        [(&MeanSpectrum {}, [8.49, 9.16]), (&LogDistance::default(), [6.89, 8.04]), (&own_laws(), [6.69, 7.74])];
    hold(&data, &partition, &other, 1.1);
    hold(&data, &partition, &[(&neighbours(5), [3.41, 5.19]), (&Kriging::default(), [3.64, 4.86])], 0.2);
}

/// g08 and g09 share one position, so both are left out; 20 links of each determine its offset.
#[test]
fn held_out_gateway_has_path_loss_and_offset() {
    let Some(data) = ble() else { return };
    for calibration in [0, 20] {
        let split = LeaveReceiverOut { receivers: vec!["g08".into(), "g09".into()], calibration, validation: 0.1 };
        let partition = split.split(&data, &mut rng::stream(0, "split", 0)).unwrap();
        let [_, mean] = errors(&data, &partition, &LogDistance { per_receiver: false, offset: true });
        assert!(mean < 20.0);
        errors(&data, &partition, &neighbours(5));
        errors(&data, &partition, &MeanSpectrum {});
    }
}
