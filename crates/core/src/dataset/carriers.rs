//! Data sets with several carriers: one receiver per carrier, at one pose.

use crate::{Dataset, Ends, Error, Receiver, Result, Sample, Scene, carrier_fault};
use std::collections::BTreeMap;

impl Dataset {
    /// Sets the carrier of each link of one receiver, Hz. If carriers differ, each becomes a receiver at the same pose, with a
    /// name such as `2400MHz`, in ascending order. Links at equal poses then share one location, with the ID of the first,
    /// unless they also have equal carriers.
    ///
    /// # Errors
    /// [`Error::Config`] for several receivers, features, another number of carriers than links, or a carrier out of
    /// range; [`Error::Read`] if a spectrum cannot be read.
    pub fn with_carriers(mut self, carriers_hz: &[f64]) -> Result<Self> {
        self.check_carriers(carriers_hz)
            .map_err(|fault| Error::Config(format!("data set `{}`: {fault}", self.title)))?;
        let mut distinct = carriers_hz.to_vec();
        distinct.sort_by(f64::total_cmp);
        distinct.dedup();
        if let [only] = distinct[..] {
            self.scene.receivers[0].carrier_hz = Some(only);
            return Ok(self);
        }
        let rows = self.sort_by_carrier(carriers_hz, &distinct);
        let order: Vec<usize> = rows.iter().map(|(.., i)| *i).collect();
        let samples: Vec<Sample> =
            rows.iter().map(|&(id, receiver, i)| Sample { id, receiver, ..self.sample(i) }).collect();
        let mut new_index = vec![0; order.len()];
        order.iter().enumerate().for_each(|(new, old)| new_index[*old] = new);
        let moved = |links: &Vec<usize>| {
            let mut links: Vec<usize> = links.iter().map(|i| new_index[*i]).collect();
            links.sort_unstable();
            links
        };
        let receivers: Vec<Receiver> = distinct.iter().map(|hz| self.scene.receivers[0].at_carrier(*hz)).collect();
        let official = self.official.as_ref().map(|(train, test)| (moved(train), moved(test)));
        let observations = self.observations.into_subset(&order)?;
        let ends = Ends { receivers: receivers.clone(), ..self.scene.ends() };
        let columns = Self::of_links(self.title, ends, Vec::new(), &samples, observations)?;
        Ok(Self {
            scene: Scene { receivers, ..self.scene },
            elevation: self.elevation,
            placed: self.placed,
            official,
            simulation: self.simulation,
            unmatched: self.unmatched,
            accepted: self.accepted,
            ..columns
        })
    }

    /// Checks for one receiver, no features, and a valid carrier per link.
    fn check_carriers(&self, carriers_hz: &[f64]) -> Result<(), String> {
        if self.scene.receivers.len() > 1 || self.features.is_some() {
            return Err("carriers need one receiver and no features; leave them out".into());
        }
        if carriers_hz.len() != self.len() {
            let (count, needed) = (carriers_hz.len(), self.len());
            return Err(format!("{count} carriers for {needed} links; give as many of each"));
        }
        let mut faults = carriers_hz.iter().enumerate().filter_map(|(i, hz)| Some((i, carrier_fault(*hz)?)));
        faults.next().map_or(Ok(()), |(i, fault)| Err(format!("carrier {}: {fault}", i + 1)))
    }

    /// Returns the links in their new order: ID of the location, index of the carrier in `distinct`, and link. At each pose, the
    /// first links of all carriers share a location, the second ones another, and so on; its ID is that of its first link.
    fn sort_by_carrier(&self, carriers_hz: &[f64], distinct: &[f64]) -> Vec<(u32, usize, usize)> {
        let (mut counts, mut first_ids) = (BTreeMap::new(), BTreeMap::new());
        let row = |(i, hz): (usize, &f64)| {
            let Sample { id, pose, .. } = self.sample(i);
            let key = (pose.position.map(f64::to_bits), pose.orientation.map(f64::to_bits));
            let receiver = distinct.partition_point(|other| other < hz);
            let count: &mut usize = counts.entry((key, receiver)).or_default();
            *count += 1;
            (*first_ids.entry((key, *count)).or_insert(id), receiver, i)
        };
        let mut rows: Vec<(u32, usize, usize)> = carriers_hz.iter().enumerate().map(row).collect();
        rows.sort_unstable();
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Pose, Spectra};

    /// Returns a data set of grey spectra 0, 1, .. at these positions along x.
    fn line(xs: &[f64]) -> Dataset {
        let sample = |(i, x): (usize, &f64)| Sample::new(i as u32 + 1, [*x, 0.0, 0.0]);
        let spectra = Spectra::grey((1, 1), (0..xs.len() as u8).collect()).unwrap();
        let data = Dataset::new("line", Pose::IDENTITY, vec![], xs.iter().enumerate().map(sample).collect(), spectra);
        Dataset { official: Some(((0..xs.len() - 1).collect(), vec![xs.len() - 1])), ..data.unwrap() }
    }

    #[test]
    fn links_at_one_position_share_a_location() {
        // Positions 0 and 1 at 3 GHz, then 1 and 0 at 2 GHz, then a repetition of 0 at 2 GHz.
        let data = line(&[0.0, 1.0, 1.0, 0.0, 0.0]).with_carriers(&[3e9, 3e9, 2e9, 2e9, 2e9]).unwrap();
        let names: Vec<&str> = data.scene.receivers.iter().map(|receiver| receiver.name.as_str()).collect();
        assert_eq!((names, data.locations.len()), (vec!["2000MHz", "3000MHz"], 3));
        let rows: Vec<(u32, f64, usize, u8)> = (0..5)
            .map(|i| {
                (data.sample(i).id, data.sample(i).position()[0], data.sample(i).receiver, data.observations.raw(i)[0])
            })
            .collect();
        assert_eq!(rows, [(1, 0.0, 0, 3), (1, 0.0, 1, 0), (2, 1.0, 0, 2), (2, 1.0, 1, 1), (5, 0.0, 0, 4)]);
        assert_eq!(data.official, Some((vec![0, 1, 2, 3], vec![4])));
    }

    #[test]
    fn one_carrier_changes_no_link() {
        let data = line(&[0.0, 1.0]).with_carriers(&[2e9; 2]).unwrap();
        assert_eq!((data.scene.receivers[0].carrier_hz, data.locations.len(), data.len()), (Some(2e9), 2, 2));
        assert_eq!(data.scene.receivers[0].name, "receiver");
    }

    #[test]
    fn rejects_invalid_carriers() {
        let fault = |hz: &[f64]| line(&[0.0, 1.0]).with_carriers(hz).unwrap_err().to_string();
        assert_eq!(fault(&[2e9]), "data set `line`: 1 carriers for 2 links; give as many of each");
        let message = "data set `line`: carrier 2: the carrier is 2.4 Hz; give a frequency between 1e6 and 1e12 Hz";
        assert_eq!(fault(&[2e9, 2.4]), message);
    }
}
