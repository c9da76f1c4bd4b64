//! Table of links: one row per received power, with the positions of transmitter and receiver.

use crate::checks::NOT_RECEIVED;
use crate::text::{read_text, table_rows};
use pwrfgs_core::files::MAX_TEXT;
use pwrfgs_core::messages::quoted;
use pwrfgs_core::{Dataset, Error, Pose, Real, Receiver, Result, Sample, Simulation};
use std::collections::BTreeMap;
use std::path::Path;

const COLUMNS: [&str; 8] = ["x", "y", "z", "receiver", "rx_x", "rx_y", "rx_z", "dbm"];
/// Largest number of pairs of transmitter and receiver: a data folder has a cell for each.
const MOST_CELLS: usize = 10_000_000;
const ADVICE: &str = "write one row per link with the columns x, y, z, receiver, rx_x, rx_y, rx_z and dbm";

/// Reads the links in `path` as a data set called `title`: columns x, y and z of the transmitter, metres; name and
/// position of the receiver; power in dBm, -100 if no signal was received. Rows with equal x, y and z are one
/// transmitter. Also returns the number of rows with -100.
///
/// # Errors
/// The file cannot be read, has an invalid row, gives one receiver two positions, or has two rows for one link.
pub fn read_links(path: &Path, title: &str, simulated: bool) -> Result<(Dataset, usize)> {
    let text = read_text(path, MAX_TEXT, ADVICE)?;
    let (mut positions, mut lines, mut links) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
    let (mut ids, mut indices, mut receivers, mut silent) = (BTreeMap::new(), BTreeMap::new(), Vec::new(), 0);
    for row in table_rows(path, &text, COLUMNS, ADVICE)? {
        let [x, y, z, name, rx_x, rx_y, rx_z, power] = row.fields;
        let tx = row.position([x, y, z], ADVICE)?.map(|v| v + 0.0); // no negative zero
        let rx = row.position([rx_x, rx_y, rx_z], ADVICE)?;
        let power = row.power(power)?;
        let fault = |problem: String| row.fault(name.column, format!("{} {problem}", quoted(name.text)));
        let (first_rx, first_line) = *positions.entry(name.text).or_insert((rx, row.line));
        if first_rx != rx {
            return Err(fault(format!("has another position in line {first_line}; give one position per receiver")));
        }
        let key = tx.map(f64::to_bits);
        if let Some(earlier) = lines.insert((key, name.text), row.line) {
            return Err(fault(format!("received this transmitter in line {earlier} too; average repeated readings")));
        }
        if power == NOT_RECEIVED {
            silent += 1;
            continue;
        }
        let (count, next) = (ids.len() as u32, receivers.len());
        let receiver = *indices.entry(name.text).or_insert(next);
        if receiver == next {
            receivers.push(Receiver::new(name.text, Pose { position: rx, ..Pose::IDENTITY }));
        }
        links.insert((*ids.entry(key).or_insert(count), receiver), (tx, power));
    }
    if ids.len() * receivers.len() > MOST_CELLS {
        let problem = format!("{} transmitters and {} receivers exceed {MOST_CELLS} pairs", ids.len(), receivers.len());
        return Err(Error::input(path, format!("{problem}; import areas with common receivers separately")));
    }
    if links.is_empty() {
        return Err(Error::input(path, format!("holds no received power; {ADVICE}")));
    }
    let samples: Vec<Sample> =
        links.iter().map(|(&(id, receiver), &(tx, _))| Sample { receiver, ..Sample::new(id, tx) }).collect();
    let powers: Vec<Real> = links.values().map(|(_, dbm)| *dbm as Real).collect();
    let data = Dataset::of_links(title, receivers, vec![], &samples, powers.into())?;
    Ok((Dataset { simulation: simulated.then(Simulation::default), ..data }, silent))
}
