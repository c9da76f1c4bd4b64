//! `Columns`: which column of a table is which, by name or by the user's choice.

use super::dialect::TableText;
use crate::text::{TextRow, is_empty_cell};
use pwrfgs_core::messages::quoted;
use pwrfgs_core::{Error, Result, did_you_mean};
use std::collections::BTreeMap;

/// Number of rows from which columns are recognised.
const EXAMINED: usize = 500;

/// Columns that the user chose: names, or numbers from 1. `None`: recognised by name.
#[derive(Clone, Debug, Default)]
#[allow(missing_docs, reason = "each is the column of that quantity")]
pub struct ColumnChoice {
    pub x: Option<String>,
    pub y: Option<String>,
    pub z: Option<String>,
    pub lat: Option<String>,
    pub lon: Option<String>,
    pub floor: Option<String>,
    pub tx_id: Option<String>,
    /// Column of the receiver in a table with a row per reading; else the name of the only receiver.
    pub receiver: Option<String>,
    pub power: Option<String>,
    pub time: Option<String>,
    /// Columns of receivers in a table with a row per transmitter: names, in which `*` stands for any text.
    pub wide: Vec<String>,
}

/// Columns of a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PlaceColumns {
    /// Columns of x and y, or of longitude and latitude.
    pub(super) plane: [usize; 2],
    /// Column of the height, metres.
    pub(super) height: Option<usize>,
    /// Whether the plane is in degrees.
    pub(super) is_geodetic: bool,
}

/// Columns of received powers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum PowerColumns {
    /// A row per reading: column of the power, of the receiver, and of the position of the receiver.
    Long { power: usize, receiver: Option<usize>, place: Option<PlaceColumns> },
    /// A row per transmitter, a column per receiver.
    Wide(Vec<usize>),
}

/// Names of a column, in lower case without blanks, marks and units.
const X: &[&str] = &[
    "x",
    "xm",
    "xpos",
    "posx",
    "xcoord",
    "coordx",
    "xcoordinate",
    "xposition",
    "positionx",
    "locx",
    "txx",
    "uex",
    "east",
    "easting",
    "ecoord",
];
const Y: &[&str] = &[
    "y",
    "ym",
    "ypos",
    "posy",
    "ycoord",
    "coordy",
    "ycoordinate",
    "yposition",
    "positiony",
    "locy",
    "txy",
    "uey",
    "north",
    "northing",
    "ncoord",
];
const Z: &[&str] = &[
    "z",
    "zm",
    "zpos",
    "posz",
    "zcoord",
    "coordz",
    "zposition",
    "positionz",
    "locz",
    "txz",
    "uez",
    "height",
    "heightm",
    "alt",
    "altitude",
    "altitudem",
    "altitudemeters",
    "elevation",
    "hcoord",
];
const LAT: &[&str] = &["lat", "latitude", "gpslat", "gpslatitude", "currentlatitude", "latdeg", "txlat"];
const LON: &[&str] = &[
    "lon",
    "lng",
    "long",
    "longitude",
    "gpslon",
    "gpslng",
    "gpslong",
    "gpslongitude",
    "currentlongitude",
    "londeg",
    "txlon",
];
const FLOOR: &[&str] = &["floor", "floorid", "storey", "floornumber"];
const TX_ID: &[&str] = &["tx", "txid", "transmitter", "transmitterid"];
const RECEIVER: &[&str] = &[
    "receiver",
    "receiverid",
    "rx",
    "rxid",
    "gateway",
    "gatewayid",
    "gw",
    "gwid",
    "ap",
    "apid",
    "bssid",
    "mac",
    "macaddress",
    "anchor",
    "anchorid",
    "beacon",
    "beaconid",
    "router",
    "station",
    "basestation",
    "cell",
    "cellid",
    "pci",
];
const POWER: &[&str] = &[
    "dbm",
    "power",
    "powerdbm",
    "rssi",
    "rssidbm",
    "rss",
    "rsrp",
    "rsrpdbm",
    "rxpower",
    "receivedpower",
    "signal",
    "signalstrength",
    "signaldbm",
    "prx",
];
/// Names of columns that are neither positions nor powers.
const OTHER: &[&str] = &[
    "id",
    "index",
    "row",
    "no",
    "number",
    "time",
    "timestamp",
    "date",
    "datetime",
    "firstseen",
    "user",
    "userid",
    "phone",
    "phoneid",
    "scene",
    "sceneid",
    "building",
    "buildingid",
    "space",
    "spaceid",
    "relativeposition",
    "sampletimes",
    "samples",
    "count",
    "channel",
    "frequency",
    "snr",
    "accuracy",
    "accuracymeters",
    "speed",
    "heading",
    "battery",
];

/// Returns a column name in lower case, without units in brackets, blanks and marks.
fn normalized(name: &str) -> String {
    let bare = name.split(['[', '(']).next().unwrap_or_default();
    bare.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// Search for columns in one table.
pub(super) struct ColumnSearch<'a> {
    table: &'a TableText,
    choice: &'a ColumnChoice,
    names: Vec<String>,
    /// First rows.
    rows: Vec<TextRow<'a>>,
}

impl<'a> ColumnSearch<'a> {
    /// Creates a search. Returns an error if one of the first rows is longer than the header.
    pub(super) fn new(table: &'a TableText, choice: &'a ColumnChoice) -> Result<Self> {
        let rows = table.rows().take(EXAMINED).collect::<Result<Vec<_>>>()?;
        let names = table.names.iter().map(|name| normalized(name)).collect();
        Ok(Self { table, choice, names, rows })
    }

    /// Returns the error `problem` at the header.
    pub(super) fn fault(&self, problem: &str) -> Error {
        Error::at(&self.table.path, self.table.header.unwrap_or(1), 1, problem)
    }

    /// Lists columns for a message.
    pub(super) fn list(&self, columns: impl IntoIterator<Item = usize>) -> String {
        columns.into_iter().map(|k| quoted(&self.table.names[k])).collect::<Vec<_>>().join(", ")
    }

    /// Returns the column called `name`, in either case, or with this number from 1; `None` without one.
    fn named(&self, name: &str) -> Option<usize> {
        let names = &self.table.names;
        let exact = names.iter().position(|column| column == name);
        let number = || name.parse::<usize>().ok().filter(|n| (1..=names.len()).contains(n)).map(|n| n - 1);
        exact.or_else(|| names.iter().position(|column| column.eq_ignore_ascii_case(name))).or_else(number)
    }

    /// Returns the column that the user chose with `option`. Returns an error if there is none.
    fn chosen(&self, option: &str, name: &str) -> Result<usize> {
        self.named(name).ok_or_else(|| {
            let hint = did_you_mean(name, self.table.names.iter().map(String::as_str));
            self.fault(&format!(
                "{option} {name}: no such column{hint}; the columns are {}",
                self.list(0..self.names.len())
            ))
        })
    }

    /// Returns the column that the user chose with `option`, else the only one with one of these names; `None` without one.
    /// Returns an error for several.
    fn find(&self, option: &str, choice: Option<&String>, names: &[&str]) -> Result<Option<usize>> {
        if let Some(name) = choice {
            return self.chosen(option, name).map(Some);
        }
        let candidates: Vec<usize> = (0..self.names.len()).filter(|k| names.contains(&&*self.names[*k])).collect();
        match candidates[..] {
            [] => Ok(None),
            [one] => Ok(Some(one)),
            _ => {
                let problem = format!("{} could each be the column of {option}", self.list(candidates));
                Err(self.fault(&format!("{problem}; name one with {option}")))
            }
        }
    }

    /// Returns the columns of the position; `None` without two coordinates. Degrees are recognised by the names latitude and
    /// longitude and their range, or declared by `is_lat_lon`. Returns an error for two positions or half of one.
    pub(super) fn place(&self, is_lat_lon: bool) -> Result<Option<PlaceColumns>> {
        let ColumnChoice { x, y, z, lat, lon, .. } = self.choice;
        let height = self.find("--z", z.as_ref(), Z)?;
        let degrees = [self.find("--lon", lon.as_ref(), LON)?, self.find("--lat", lat.as_ref(), LAT)?];
        let metres = [self.find("--x", x.as_ref(), X)?, self.find("--y", y.as_ref(), Y)?];
        let are_metres_chosen = x.is_some() || y.is_some();
        match (metres, degrees) {
            ([Some(x), Some(y)], [Some(lon), Some(lat)]) if !are_metres_chosen && self.choice.lat.is_none() => {
                let problem = format!("{} and {} could each be the position", self.list([x, y]), self.list([lat, lon]));
                Err(self.fault(&format!("{problem}; name one pair with --x and --y, or with --lat and --lon")))
            }
            ([Some(x), Some(y)], _) if are_metres_chosen || degrees == [None; 2] => {
                Ok(Some(oriented([x, y], height, is_lat_lon)))
            }
            (_, [Some(lon), Some(lat)]) => {
                let is_in = |k: usize, limit: f64| self.values(k).all(|v| v.abs() <= limit);
                let is_geodetic = is_lat_lon || is_in(lat, 90.0) && is_in(lon, 180.0);
                Ok(Some(PlaceColumns { plane: [lon, lat], height, is_geodetic }))
            }
            ([None, None], [None, None]) => Ok(None),
            _ => Err(self.fault("only one coordinate of the position was recognised; name both with --x and --y, or with --lat and --lon")),
        }
    }

    /// Returns the columns of the received powers, none of which are in `used`. Returns an error if none or several suit.
    pub(super) fn powers(&self, used: &[usize], is_lat_lon: bool) -> Result<PowerColumns> {
        if !self.choice.wide.is_empty() {
            return self.chosen_wide().map(PowerColumns::Wide);
        }
        let power = self.find("--power", self.choice.power.as_ref(), POWER)?;
        if let Some(power) = power {
            let again = |k: &usize| {
                *k != power
                    && self.choice.power.is_none()
                    && POWER.contains(&self.names[*k].trim_end_matches(|c: char| c.is_ascii_digit()))
            };
            let others: Vec<usize> = (0..self.names.len()).filter(again).chain([power]).collect();
            if others.len() > 1 {
                let problem = format!("{} could each be the power", self.list(others));
                return Err(
                    self.fault(&format!("{problem}; name one with --power, or those of all receivers with --columns"))
                );
            }
            let is_name = self.choice.receiver.as_ref().is_some_and(|name| self.named(name).is_none());
            let receiver =
                if is_name { None } else { self.find("--receiver", self.choice.receiver.as_ref(), RECEIVER)? };
            return Ok(PowerColumns::Long { power, receiver, place: self.receiver_place(is_lat_lon) });
        }
        self.recognised_wide(used).map(PowerColumns::Wide)
    }

    /// Returns the columns of the receiver's position beside a reading, such as `rx_x`; `None` without them.
    fn receiver_place(&self, is_lat_lon: bool) -> Option<PlaceColumns> {
        let prefixed = |ends: &[&str]| {
            let is_named =
                |name: &String| RECEIVER.iter().any(|start| ends.iter().any(|end| *name == format!("{start}{end}")));
            self.names.iter().position(is_named)
        };
        let height = prefixed(&["z", "height", "altitude", "alt"]);
        let pair = |a: &[&str], b: &[&str]| Some([prefixed(a)?, prefixed(b)?]);
        let metres = pair(&["x"], &["y"]).map(|[x, y]| oriented([x, y], height, is_lat_lon));
        let degrees = || pair(&["lon", "longitude", "lng"], &["lat", "latitude"]);
        metres.or_else(|| degrees().map(|plane| PlaceColumns { plane, height, is_geodetic: true }))
    }

    /// Returns the columns that match the patterns of the user. Returns an error for a pattern without a column.
    fn chosen_wide(&self) -> Result<Vec<usize>> {
        let mut columns = Vec::new();
        for pattern in &self.choice.wide {
            let matching: Vec<usize> =
                (0..self.names.len()).filter(|k| matches(pattern, &self.table.names[*k])).collect();
            if matching.is_empty() {
                return Err(self.fault(&format!(
                    "--columns {pattern}: no column has such a name; the columns are {}",
                    self.list(0..self.names.len())
                )));
            }
            columns.extend(matching);
        }
        columns.sort_unstable();
        columns.dedup();
        Ok(columns)
    }

    /// Recognises the columns of receivers: the largest group of names that differ in numbers alone, else all columns that hold
    /// powers. Returns an error if there is none, or if two groups are equal in size.
    fn recognised_wide(&self, used: &[usize]) -> Result<Vec<usize>> {
        let known = [X, Y, Z, LAT, LON, FLOOR, TX_ID, RECEIVER, OTHER].concat();
        let is_free = |k: &usize| !used.contains(k) && !known.contains(&&*self.names[*k]) && self.holds_powers(*k);
        let free: Vec<usize> = (0..self.names.len()).filter(is_free).collect();
        let mut groups: BTreeMap<String, Vec<usize>> = BTreeMap::new();
        free.iter().for_each(|&k| groups.entry(self.stem(k)).or_default().push(k));
        let size = groups.values().map(Vec::len).max().unwrap_or(0);
        let mut largest = groups.into_values().filter(|group| group.len() == size);
        match (largest.next(), largest.next()) {
            (Some(group), Some(other)) if size > 1 => {
                let problem = format!("{} .. and {} .. could each be the received powers", self.list([group[0]]), self.list([other[0]]));
                Err(self.fault(&format!("{problem}; name those of one kind with --columns, such as --columns '{}*'", self.names[group[0]])))
            }
            (Some(group), None) if size > 1 => Ok(group),
            (Some(_), _) => Ok(free),
            _ => Err(self.fault(&format!(
                "no column of received powers was recognised among {}; name it with --power, or those of all receivers with --columns",
                self.list(0..self.names.len())
            ))),
        }
    }

    /// Returns the name of a column with its numbers replaced; MAC addresses have one stem.
    fn stem(&self, k: usize) -> String {
        let name = &self.table.names[k];
        let is_address = name.len() == 17 && name.chars().all(|c| c.is_ascii_hexdigit() || c == ':' || c == '-');
        if is_address {
            "address".into()
        } else {
            name.split(|c: char| c.is_ascii_digit()).filter(|part| !part.is_empty()).collect::<Vec<_>>().join("0")
        }
    }

    /// Returns whether a column holds powers: numbers and empty cells, not all equal to whole numbers above 300.
    fn holds_powers(&self, k: usize) -> bool {
        let cells = || self.rows.iter().filter_map(|row| row.fields.get(k)).filter(|field| !is_empty_cell(field.text));
        cells().count() == self.values(k).count() && self.values(k).all(|v| v.abs() <= 300.0)
    }

    /// Returns the numbers of a column in the first rows.
    fn values(&self, k: usize) -> impl Iterator<Item = f64> + '_ {
        self.rows.iter().filter_map(move |row| self.table.number(row, *row.fields.get(k)?, "").ok().flatten())
    }

    /// Returns the column that holds only names out of `names`; `None` without one.
    pub(super) fn named_places(&self, names: &BTreeMap<String, [f64; 3]>) -> Option<usize> {
        (0..self.names.len()).find(|k| {
            let mut cells = self.rows.iter().filter_map(|row| row.fields.get(*k)).peekable();
            cells.peek().is_some() && cells.all(|field| names.contains_key(field.text))
        })
    }

    /// Returns the column of names in a table of places or receivers: the chosen one, else the first that is not a coordinate.
    pub(super) fn name(&self, place: PlaceColumns) -> Option<usize> {
        let is_name = |k: &usize| {
            RECEIVER.contains(&&*self.names[*k]) || ["name", "place", "location", "point"].contains(&&*self.names[*k])
        };
        let is_other = |k: &usize| !place.plane.contains(k) && place.height != Some(*k);
        (0..self.names.len()).find(is_name).or_else(|| (0..self.names.len()).find(is_other))
    }

    /// Returns the column of the floor; `None` without one.
    pub(super) fn floor(&self) -> Result<Option<usize>> {
        self.find("--floor", self.choice.floor.as_ref(), FLOOR)
    }

    /// Returns the columns whose values make a transmitter: ID and time, as far as the user chose them or the table names a
    /// transmitter.
    pub(super) fn transmitter(&self) -> Result<Vec<usize>> {
        let id = self.find("--tx-id", self.choice.tx_id.as_ref(), TX_ID)?;
        let time = self.choice.time.as_ref().map(|name| self.chosen("--time", name)).transpose()?;
        Ok(id.into_iter().chain(time).collect())
    }
}

impl PlaceColumns {
    /// Returns whether coordinates taken as metres look like degrees: a site of less than 20 cm, metres away from zero.
    pub(super) fn looks_like_degrees(self, search: &ColumnSearch<'_>) -> bool {
        let is_small = |k: usize| {
            let (low, high) = search.values(k).fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
            (0.0..0.2).contains(&(high - low)) && low.abs().min(high.abs()) > 1.0 && high.abs() <= 180.0
        };
        !self.is_geodetic && self.plane.into_iter().all(is_small)
    }
}

/// Returns columns called x and y. In degrees, the first is the latitude, as people say it.
fn oriented([x, y]: [usize; 2], height: Option<usize>, is_geodetic: bool) -> PlaceColumns {
    PlaceColumns { plane: if is_geodetic { [y, x] } else { [x, y] }, height, is_geodetic }
}

/// Returns whether a name matches a pattern in which `*` stands for any text; either case.
fn matches(pattern: &str, name: &str) -> bool {
    let (pattern, name) = (pattern.to_lowercase(), name.to_lowercase());
    let parts: Vec<&str> = pattern.split('*').collect();
    let [first, middle @ .., last] = &parts[..] else { return name == pattern };
    let Some(rest) = name.strip_prefix(first).and_then(|rest| rest.strip_suffix(last)) else { return false };
    middle.iter().try_fold(rest, |rest, part| rest.find(part).map(|at| &rest[at + part.len()..])).is_some()
}
