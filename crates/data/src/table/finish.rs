//! Makes a data set of the readings of a survey.

use super::columns::{SHOWN, list};
use super::options::ImportedTable;
use super::survey::{NamedReceiver, PREVIEW, Reading, Spot, Survey};
use pwrfgs_core::{Dataset, Error, Geodetic, Link, Location, Pose, Real, Receiver, Result, Simulation};
use std::collections::HashMap;

impl Survey<'_> {
    /// Creates the data set. Returns an error if no power was received, if several floors have no height, if the file of --tx
    /// has more rows than the readings, or if --receivers has a position of no receiver with a reading.
    pub(super) fn finish(mut self) -> Result<ImportedTable> {
        let path = &self.import.files.first().map(|file| file.path.clone()).unwrap_or_default();
        if self.rows.as_mut().is_some_and(|rows| rows.next().is_some()) {
            let problem = "the file of --tx has more rows than the readings; give a position per row";
            return Err(Error::input(path, problem));
        }
        if self.floors.len() > 1 && self.import.floor_height.is_none() {
            let floors = list(self.floors.keys().map(String::as_str));
            let problem = format!("has the floors {floors}; give their height with --floor-height METRES");
            return Err(Error::input(path, problem));
        }
        if self.readings.is_empty() {
            let problem = "holds no received power; write one row per reading, or check --missing";
            return Err(Error::input(path, problem));
        }
        (self.groups, self.positions.first) = Default::default(); // frees memory: no row follows
        self.separate_repetitions();
        self.readings.sort_unstable_by_key(|reading| (reading.location, reading.receiver));
        let receivers = self.linked_receivers();
        self.check_names(&receivers)?;
        self.add_notes(&receivers);
        let (locations, links) = self.number_links(&receivers);
        let powers: Vec<Real> = self.readings.iter().map(|reading| reading.dbm).collect();
        let is_test: Vec<bool> =
            self.readings.iter().map(|reading| self.spots[reading.location as usize].is_test).collect();
        (self.readings, self.spots, self.positions) = Default::default(); // the data set has them now
        let receivers: Vec<Receiver> = receivers.into_iter().flatten().collect();
        let mut data =
            Dataset::of_columns(&self.import.title, receivers.into(), vec![], locations, links, powers.into())?;
        let links_of = |test: bool| (0..is_test.len()).filter(|i| is_test[*i] == test).collect::<Vec<usize>>();
        data.official = (!self.import.test.is_empty()).then(|| (links_of(false), links_of(true)));
        data.estimate_receivers(&(0..data.len()).collect::<Vec<_>>());
        (data.scene.geodetic, data.scene.floors) = (self.frame.geodetic, std::mem::take(&mut self.floors));
        data.simulation = self.import.is_simulated.then(Simulation::default);
        let after = describe_first_locations(&data);
        Ok(ImportedTable { data, notes: self.notes, before: self.before, after })
    }

    /// Gives repeated readings of a link locations of their own, leaves out locations without a reading, and counts both. Sorts
    /// locations by their first reading.
    fn separate_repetitions(&mut self) {
        let link = |k: &u32| (self.readings[*k as usize].location, self.readings[*k as usize].receiver);
        let mut order: Vec<u32> = (0..self.readings.len() as u32).collect();
        order.sort_by_key(link);
        let (mut repetition, mut repeats) = (0, Vec::new());
        for pair in order.windows(2) {
            repetition = if link(&pair[0]) == link(&pair[1]) { repetition + 1 } else { 0 };
            repeats.extend((repetition > 0).then_some((pair[1] as usize, repetition)));
        }
        drop(order);
        self.repeated = repeats.len();
        // The n-th repetitions at several receivers share one location.
        let mut separate: HashMap<(u32, usize), u32> = HashMap::new();
        for (k, repetition) in repeats {
            let Reading { location, .. } = &mut self.readings[k];
            *location = *separate.entry((*location, repetition)).or_insert_with(|| {
                self.spots.push(self.spots[*location as usize]);
                self.spots.len() as u32 - 1
            });
        }
        let (mut new_location, mut spots) = (vec![u32::MAX; self.spots.len()], Vec::with_capacity(self.spots.len()));
        for reading in &mut self.readings {
            let location = &mut new_location[reading.location as usize];
            if *location == u32::MAX {
                *location = spots.len() as u32;
                spots.push(self.spots[reading.location as usize]);
            }
            reading.location = *location;
        }
        self.unreceived_rows = self.spots.len() - spots.len();
        self.spots = spots;
    }

    /// Returns the receivers, `None` for those without a reading. Those of unknown position are at the first position of a
    /// transmitter until they are estimated.
    fn linked_receivers(&self) -> Vec<Option<Receiver>> {
        let mut is_linked = vec![false; self.receivers.len()];
        self.readings.iter().for_each(|reading| is_linked[reading.receiver as usize] = true);
        let create = |(receiver, is_linked): (&NamedReceiver, bool)| {
            let pose = Pose::from(receiver.position.unwrap_or(self.positions.list[0]));
            let named = Receiver { is_estimated: receiver.position.is_none(), ..Receiver::new(&*receiver.name, pose) };
            is_linked.then_some(named)
        };
        self.receivers.iter().zip(is_linked).map(create).collect()
    }

    /// Rejects a file of receivers if no receiver with a reading has a position.
    fn check_names(&self, receivers: &[Option<Receiver>]) -> Result<()> {
        let Some(file) = &self.import.receivers else { return Ok(()) };
        if receivers.iter().flatten().any(|receiver| !receiver.is_estimated) {
            return Ok(());
        }
        let placed = list(self.receivers[..self.placed_count].iter().map(|receiver| &*receiver.name));
        let received = list(receivers.iter().flatten().map(|receiver| &*receiver.name));
        let problem =
            format!("has the names {placed}, but the powers are those of {received}; give both the same names");
        Err(Error::input(&file.path, problem))
    }

    /// Returns the locations and links of the data set; `receivers` that are `None` have no number.
    fn number_links(&self, receivers: &[Option<Receiver>]) -> (Vec<Location>, Vec<Link>) {
        let mut new_receivers = vec![0; receivers.len()];
        for (next, receiver) in (0..receivers.len()).filter(|r| receivers[*r].is_some()).enumerate() {
            new_receivers[receiver] = next;
        }
        let pose = |spot: &Spot| Pose::from(self.positions.list[spot.position as usize]);
        let locations = self.spots.iter().enumerate().map(|(id, spot)| Location { id: id as u32, pose: pose(spot) });
        let link = |reading: &Reading| Link {
            location: reading.location as usize,
            receiver: new_receivers[reading.receiver as usize],
        };
        (locations.collect(), self.readings.iter().map(link).collect())
    }

    /// Notes what was joined, left out and assumed; `receivers` are `None` if they are left out.
    fn add_notes(&mut self, receivers: &[Option<Receiver>]) {
        let coded = self.import.missing.iter().zip(&self.coded);
        self.notes.extend(coded.map(|(code, count)| format!("{count} cells are {code}, not received")));
        let unlinked =
            self.receivers.iter().zip(receivers).filter(|(_, linked)| linked.is_none()).map(|(r, _)| &*r.name);
        let (unlinked, respelled) = (unlinked.collect::<Vec<&str>>(), self.respelled.iter().map(String::as_str));
        let counted = [
            (self.silent, "cells are empty, not received".to_owned()),
            (
                unlinked.len(),
                format!("receivers received nothing and are left out: {}", list(unlinked.iter().copied())),
            ),
            (self.unreceived_rows, "rows reached no receiver and are left out".into()),
            (self.repeated, "readings repeat a link: each has a location at the same position".into()),
            (self.positions.joined, "positions are within 1 mm of another and are joined with it".into()),
            (
                self.respelled.len(),
                format!("receiver names differ from another only by case and are joined: {}", list(respelled)),
            ),
        ];
        let counted = counted.into_iter().filter(|(count, _)| *count > 0);
        self.notes.extend(counted.map(|(count, text)| format!("{count} {text}")));
        let zero = self.frame.geodetic.map(|zero| {
            let Geodetic { latitude, longitude } = zero;
            format!("degrees become metres east and north of latitude {latitude}, longitude {longitude}")
        });
        self.notes.extend(zero);
    }
}

/// Describes the first locations and their powers, one line each.
fn describe_first_locations(data: &Dataset) -> Vec<String> {
    let line = |l: usize| {
        let [x, y, z] = data.locations[l].position();
        let links = data.links_of(&[l]);
        let power = |i: &usize| {
            format!("{} {} dBm", data.scene.receivers[data.links[*i].receiver].name, data.image(*i).pixels[0])
        };
        let powers: Vec<String> = links.iter().take(SHOWN).map(power).collect();
        let more = if links.len() > SHOWN { format!(", and {} more", links.len() - SHOWN) } else { String::new() };
        format!("({x:.3}, {y:.3}, {z:.3}) m: {}{more}", powers.join(", "))
    };
    (0..data.locations.len().min(PREVIEW)).map(line).collect()
}
