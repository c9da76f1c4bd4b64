//! Estimated positions of receivers.

use crate::Dataset;

/// Power below the strongest one up to which readings locate a receiver, dB.
const NEAR_DB: f64 = 6.0;

impl Dataset {
    /// Places the receivers of unknown position ([`is_estimated`](crate::Receiver::is_estimated)) by received powers of these
    /// links: at the mean of the locations of their strongest readings, within 6 dB of the strongest, weighted by power. A
    /// receiver without such a link keeps its position. Other observations than received powers locate no receiver.
    pub fn estimate_receivers(&mut self, links: &[usize]) {
        let Some(powers) = self.observations.powers() else { return };
        let origin = self.scene.origin;
        for (receiver, links) in self.group_by_receiver(links.iter().copied()).into_iter().enumerate() {
            if !self.scene.receivers[receiver].is_estimated {
                continue;
            }
            let dbm = |i: &usize| powers[*i] as f64;
            let strongest = links.iter().map(dbm).fold(f64::NEG_INFINITY, f64::max);
            let (mut sum, mut total) = ([0.0; 3], 0.0);
            for i in links.iter().filter(|i| strongest - dbm(i) <= NEAR_DB) {
                let (weight, position) = (10_f64.powf((dbm(i) - strongest) / 10.0), self.sample(*i).position());
                (0..3).for_each(|k| sum[k] += weight * position[k]);
                total += weight;
            }
            if total > 0.0 {
                let pose = origin.local_pose(sum.map(|v| v / total).into());
                self.scene.receivers[receiver].pose.position = pose.position;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::{Dataset, Pose, Receiver, Sample};

    /// Two readings within 6 dB of the strongest, with the weights 1 and 1/2; the third is weaker.
    #[test]
    fn receiver_stands_at_its_strongest_readings() {
        let receiver = Receiver { is_estimated: true, ..Receiver::new("a", Pose::IDENTITY) };
        let samples: Vec<Sample> =
            [0.0, 3.0, 90.0].iter().zip(0..).map(|(x, id)| Sample::new(id, [*x, 2.0, 1.0])).collect();
        let powers = vec![-40.0, -43.010_3, -60.0];
        let mut data = Dataset::of_links("hall", vec![receiver], vec![], &samples, powers.into()).unwrap();
        data.estimate_receivers(&[0, 1, 2]);
        let [x, y, z] = data.scene.receivers[0].pose.position;
        assert!((x - 1.0).abs() < 1e-6 && (y, z) == (2.0, 1.0), "{x}");
        assert!(!data.scene.has_distances());
        data.estimate_receivers(&[2]);
        assert_eq!(data.scene.receivers[0].pose.position, [90.0, 2.0, 1.0]);
    }
}
