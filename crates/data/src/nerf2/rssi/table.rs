//! `gateway_rssi.csv`: a column a gateway, a row a transmitter.

use crate::checks::{NOT_RECEIVED, Unheard, unheard};
use crate::text::{Field, lines, no_longer, power, read_text, split_commas};
use pwrfgs_core::words::{clean, quoted, text_of};
use pwrfgs_core::{Error, Result, did_you_mean, files::MAX_TEXT};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// One power that was received.
pub(super) struct Heard {
    /// Of the transmitters, counted from 0.
    pub(super) row: usize,
    /// Into the gateways.
    pub(super) gateway: usize,
    pub(super) dbm: f64,
}

/// All that was heard, by row, then gateway. Every gateway has a column, every transmitter of `rows` a row, and each of
/// them was heard at least once.
pub(super) fn read(path: &Path, gateways: &[String], rows: usize, advice: &str) -> Result<Vec<Heard>> {
    let text = read_text(path, MAX_TEXT, advice)?;
    let mut contents = lines(&text);
    let Some((line, header)) = contents.next() else {
        return Err(Error::input(
            path,
            "is empty; write a header with the names of the gateways and a row a transmitter",
        ));
    };
    let header = split_commas(header);
    let column_of = columns(path, line, &header, gateways)?;
    let (mut heard, mut lines_of): (Vec<Heard>, Vec<usize>) = (Vec::new(), Vec::new());
    for (row, (line, content)) in contents.enumerate() {
        let fields = split_commas(content);
        no_longer(path, line, &fields, header.len())?;
        for (gateway, &column) in column_of.iter().enumerate() {
            let dbm = power(path, line, &fields, (column, &gateways[gateway]))?;
            heard.extend((dbm != NOT_RECEIVED).then_some(Heard { row, gateway, dbm }));
        }
        lines_of.push(line);
    }
    let count = lines_of.len();
    if count != rows {
        let what = format!("holds {count} rows of powers, but tx_pos.csv {rows} transmitters; give as many of each");
        return Err(Error::input(path, what));
    }
    match unheard(rows, gateways.len(), heard.iter().map(|link| (link.row, link.gateway))) {
        Some(Unheard::Transmitter(row)) => {
            let what = "no gateway heard this transmitter (-100 in all columns); remove the row here and in tx_pos.csv, \
                        and number the index files anew";
            Err(Error::at(path, lines_of[row], 1, what))
        }
        Some(Unheard::Receiver(g)) => {
            let what = format!("{} heard no transmitter (-100 in all rows)", quoted(&gateways[g]));
            let what = format!("{what}; remove its column here and its line in gateway_position.yml");
            Err(Error::at(path, line, header[column_of[g]].column, what))
        }
        None => Ok(heard),
    }
}

/// In which column each gateway stands.
fn columns(path: &Path, line: usize, header: &[Field<'_>], gateways: &[String]) -> Result<Vec<usize>> {
    let names = || gateways.iter().map(String::as_str);
    let known: BTreeSet<&str> = names().collect();
    let mut column_of = BTreeMap::new();
    for (k, field) in header.iter().enumerate() {
        let at = |what| Error::at(path, line, field.column, what);
        let text = text_of(field.text);
        let name = if known.contains(text) { text } else { field.text };
        if column_of.insert(name, k).is_some() {
            return Err(at(format!("a second column {}; name each gateway once", quoted(field.text))));
        }
        if !known.contains(name) {
            let near = did_you_mean(field.text, names());
            let what = format!("{} has no position in gateway_position.yml{near}", quoted(field.text));
            return Err(at(format!("{what}; add it there, or remove the column")));
        }
    }
    let column = |name: &str| {
        column_of.get(name).copied().ok_or_else(|| {
            let what = "add one, or remove its line in gateway_position.yml";
            Error::at(path, line, 1, format!("no column `{}`, a gateway that has a position; {what}", clean(name)))
        })
    };
    names().map(column).collect()
}
