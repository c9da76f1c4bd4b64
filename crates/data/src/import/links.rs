//! Table of links: one row per received power, with the positions of transmitter and receiver.

use crate::checks::NOT_RECEIVED;
use crate::text::{dbm, place, read_text, table};
use pwrfgs_core::files::MAX_TEXT;
use pwrfgs_core::messages::quoted;
use pwrfgs_core::{Dataset, Error, Pose, Real, Receiver, Result, Sample, Simulation};
use std::collections::BTreeMap;
use std::path::Path;

const COLUMNS: [&str; 8] = ["x", "y", "z", "receiver", "rx_x", "rx_y", "rx_z", "dbm"];
const ADVICE: &str = "write one row per link with the columns x, y, z, receiver, rx_x, rx_y, rx_z and dbm";

/// Reads the links in `path`: columns x, y and z of the transmitter, metres; name and position of the receiver; power in
/// dBm, -100 if no signal was received. Rows with equal x, y and z are one transmitter.
///
/// # Errors
/// An invalid row, two positions of one receiver, or two rows of one link.
pub fn links(path: &Path, name: &str, simulated: bool) -> Result<Dataset> {
    let text = read_text(path, MAX_TEXT, ADVICE)?;
    let (mut ids, mut receivers) = (BTreeMap::new(), Vec::<(Receiver, usize)>::new());
    let mut found: BTreeMap<(u32, usize), ([f64; 3], f64, usize)> = BTreeMap::new();
    for (line, [x, y, z, own, rx_x, rx_y, rx_z, power]) in table(path, &text, COLUMNS, ADVICE)? {
        let tx = place(path, line, [x, y, z], ADVICE)?.map(|v| v + 0.0); // no negative zero
        let position = place(path, line, [rx_x, rx_y, rx_z], ADVICE)?;
        let power = dbm(path, line, power)?;
        if power == NOT_RECEIVED {
            continue;
        }
        let fault = |what: String| Error::at(path, line, own.column, format!("{} {what}", quoted(own.text)));
        let known = receivers.iter().position(|(receiver, _)| receiver.name == own.text);
        let receiver = known.unwrap_or(receivers.len());
        match receivers.get(receiver) {
            Some((there, line)) if there.pose.position != position => {
                return Err(fault(format!("has another position in line {line}; give one position per receiver")));
            }
            Some(_) => {}
            None => receivers.push((Receiver::new(own.text, Pose { position, ..Pose::IDENTITY }), line)),
        }
        let count = ids.len() as u32;
        let id = *ids.entry(tx.map(f64::to_bits)).or_insert(count);
        if let Some((.., earlier)) = found.insert((id, receiver), (tx, power, line)) {
            return Err(fault(format!("received this transmitter in line {earlier} too; average repeated readings")));
        }
    }
    if found.is_empty() {
        return Err(Error::input(path, format!("holds no received power; {ADVICE}")));
    }
    let samples: Vec<Sample> = found.iter().map(|(&(id, receiver), &(tx, ..))| Sample { id, tx, receiver }).collect();
    let powers: Vec<Real> = found.values().map(|(_, dbm, _)| *dbm as Real).collect();
    let receivers = receivers.into_iter().map(|(receiver, _)| receiver).collect();
    let data = Dataset::of_links(name, receivers, vec![], &samples, powers.into())?;
    Ok(Dataset { simulation: simulated.then(Simulation::default), ..data })
}
