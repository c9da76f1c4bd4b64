//! `ColumnSearch`: which column of a table is which, by name or by the user's choice.

use super::names::{FLOOR, LAT, LON, PLACE, RECEIVER, TX_ID, X, Y, Z, is_one_of, normalised_name};
use super::options::ColumnChoice;
use crate::dialect::TableText;
use crate::text::{TextRow, is_metre, split_unit};
use pwrfgs_core::messages::quoted;
use pwrfgs_core::{Error, Result, did_you_mean};
use std::collections::BTreeMap;

/// Number of rows from which columns are recognised.
const EXAMINED: usize = 500;
/// Number of names in a list.
pub(super) const SHOWN: usize = 5;

/// Columns of a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PositionColumns {
    /// Columns of x and y, or of longitude and latitude.
    pub(super) plane: [usize; 2],
    /// Column of the height, metres.
    pub(super) height: Option<usize>,
    /// Whether the plane is in degrees.
    pub(super) is_geodetic: bool,
}

impl PositionColumns {
    /// Creates the columns of a position from those of x and y, or of latitude and longitude if they are geodetic.
    pub(super) fn new([a, b]: [usize; 2], height: Option<usize>, is_geodetic: bool) -> Self {
        Self { plane: if is_geodetic { [b, a] } else { [a, b] }, height, is_geodetic }
    }

    /// Returns the columns of all coordinates.
    pub(super) fn all(self) -> impl Iterator<Item = usize> {
        self.plane.into_iter().chain(self.height)
    }
}

/// Search for columns in one table.
pub(super) struct ColumnSearch<'a> {
    pub(super) table: &'a TableText<'a>,
    pub(super) choice: &'a ColumnChoice,
    /// Names in lower case, without units.
    pub(super) names: Vec<String>,
    /// First rows.
    pub(super) rows: Vec<TextRow<'a>>,
}

impl<'a> ColumnSearch<'a> {
    /// Creates a search. Returns an error if one of the first rows is longer than the header.
    pub(super) fn new(table: &'a TableText<'a>, choice: &'a ColumnChoice) -> Result<Self> {
        let rows = table.rows().take(EXAMINED).collect::<Result<Vec<_>>>()?;
        let names = table.names.iter().map(|name| normalised_name(name)).collect();
        Ok(Self { table, choice, names, rows })
    }

    /// Returns the error `problem` at the header.
    pub(super) fn fault(&self, problem: impl std::fmt::Display) -> Error {
        self.table.fault(None, problem)
    }

    /// Lists the names of columns, as [`list`].
    pub(super) fn list(&self, columns: impl IntoIterator<Item = usize>) -> String {
        list(columns.into_iter().map(|k| &*self.table.names[k]))
    }

    /// Returns the column called `name`, in either case, or with this number from 1; `None` without one.
    pub(super) fn named(&self, name: &str) -> Option<usize> {
        let names = &self.table.names;
        let exact = names.iter().position(|column| column == name);
        let number = || name.parse::<usize>().ok().filter(|n| (1..=names.len()).contains(n)).map(|n| n - 1);
        exact.or_else(|| names.iter().position(|column| column.eq_ignore_ascii_case(name))).or_else(number)
    }

    /// Returns the column that the user chose with `option`. Returns an error if there is none.
    fn chosen(&self, option: &str, name: &str) -> Result<usize> {
        self.named(name).ok_or_else(|| {
            let hint = did_you_mean(name, self.table.names.iter().map(String::as_str));
            let columns = self.list(0..self.names.len());
            self.fault(format!("{option} {name}: no such column{hint}; the columns are {columns}"))
        })
    }

    /// Returns the column that the user chose with `option`, else the only one with one of these names; `None` without one.
    /// Returns an error for several.
    pub(super) fn find(&self, option: &str, choice: Option<&String>, names: &str) -> Result<Option<usize>> {
        if let Some(name) = choice {
            return self.chosen(option, name).map(Some);
        }
        let candidates: Vec<usize> = (0..self.names.len()).filter(|k| is_one_of(&self.names[*k], names)).collect();
        if candidates.len() > 1 {
            let problem = format!("{} could each be the column of {option}", self.list(candidates));
            return Err(self.fault(format!("{problem}; name one with {option}")));
        }
        Ok(candidates.first().copied())
    }

    /// Returns the columns of the position; `None` without any coordinate. Degrees are recognised by the names latitude and
    /// longitude and their range, or declared by `is_lat_lon`. Returns an error for two positions, half of one, another unit
    /// than metres, and metres that look like degrees.
    pub(super) fn position_columns(&self, is_lat_lon: bool) -> Result<Option<PositionColumns>> {
        let ColumnChoice { x, y, z, lat, lon, .. } = self.choice;
        let height = self.find("--z", z.as_ref(), Z)?;
        let degrees = [self.find("--lat", lat.as_ref(), LAT)?, self.find("--lon", lon.as_ref(), LON)?];
        let metres = [self.find("--x", x.as_ref(), X)?, self.find("--y", y.as_ref(), Y)?];
        let (chose_metres, chose_degrees) = (x.is_some() || y.is_some(), lat.is_some() || lon.is_some());
        for k in metres.into_iter().chain([height]).flatten() {
            let (_, unit) = split_unit(&self.table.names[k]);
            if !is_lat_lon && !is_metre(unit) {
                let problem = format!("{} is not in metres", self.list([k]));
                return Err(self.fault(format!("{problem}; convert the column, and leave its unit out")));
            }
        }
        match (metres, degrees) {
            ([Some(x), Some(y)], [Some(lat), Some(lon)]) if chose_metres == chose_degrees => {
                let problem = format!("{} and {} could each be the position", self.list([x, y]), self.list([lat, lon]));
                Err(self.fault(format!("{problem}; name one pair with --x and --y, or with --lat and --lon")))
            }
            ([Some(x), Some(y)], _) if !chose_degrees => {
                let columns = PositionColumns::new([x, y], height, is_lat_lon);
                if !is_lat_lon && self.is_like_degrees(columns) {
                    let problem = format!("{} look like degrees", self.list(columns.plane));
                    return Err(self.fault(format!("{problem}; add --lat-lon, or --lat COLUMN --lon COLUMN")));
                }
                Ok(Some(columns))
            }
            (_, [Some(lat), Some(lon)]) => {
                let is_in = |k: usize, limit: f64| self.values(k).all(|v| v.abs() <= limit);
                let is_geodetic = is_lat_lon || is_in(lat, 90.0) && is_in(lon, 180.0);
                Ok(Some(PositionColumns { plane: [lon, lat], height, is_geodetic }))
            }
            ([None, None], [None, None]) => Ok(None),
            _ => Err(self.fault(
                "only one coordinate of the position was recognised; name both with --x and --y, or with --lat and --lon",
            )),
        }
    }

    /// Returns whether coordinates look like degrees: a site of less than 0.2 (20 cm if they were metres, about 20 km as
    /// degrees), more than 1 away from zero, and at most 180.
    fn is_like_degrees(&self, columns: PositionColumns) -> bool {
        columns.plane.into_iter().all(|k| {
            let (low, high) = self.values(k).fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
            self.rows.len() > 1 && high - low < 0.2 && low.abs().min(high.abs()) > 1.0 && high.abs() <= 180.0
        })
    }

    /// Returns the numbers of a column in the first rows; other cells are skipped.
    pub(super) fn values(&self, k: usize) -> impl Iterator<Item = f64> + '_ {
        self.rows.iter().filter_map(move |row| row.optional(*row.fields.get(k)?, "").ok().flatten())
    }

    /// Returns the first column that holds only names out of `names`. Returns an error if there is none.
    pub(super) fn place_column(&self, names: &BTreeMap<String, [f64; 3]>) -> Result<usize> {
        let is_known = |k: &usize| {
            let mut cells = self.rows.iter().filter_map(|row| row.fields.get(*k)).peekable();
            cells.peek().is_some() && cells.all(|field| names.contains_key(field.text))
        };
        let problem = "no column holds only names of --places; add the missing ones there";
        (0..self.names.len()).find(is_known).ok_or_else(|| self.fault(problem))
    }

    /// Returns the column of names in a table of places or receivers: by its name, else the first that is no coordinate of
    /// `position`. Returns an error if there is none.
    pub(super) fn name_column(&self, position: PositionColumns) -> Result<usize> {
        let is_name = |k: &usize| is_one_of(&self.names[*k], RECEIVER) || is_one_of(&self.names[*k], PLACE);
        let is_other = |k: &usize| position.all().all(|column| column != *k);
        let columns = 0..self.names.len();
        let column = columns.clone().find(is_name).or_else(|| columns.clone().find(is_other));
        column.ok_or_else(|| self.fault("no column of names; add one called `name`"))
    }

    /// Returns the column of the floor; `None` without one. Returns an error for several.
    pub(super) fn floor_column(&self) -> Result<Option<usize>> {
        self.find("--floor", self.choice.floor.as_ref(), FLOOR)
    }

    /// Returns the columns whose cells identify a transmitter: the ID, and the time if the user chose it. Returns an error for a
    /// column that does not exist, or several of the ID.
    pub(super) fn transmitter_columns(&self) -> Result<Vec<usize>> {
        let id = self.find("--tx-id", self.choice.tx_id.as_ref(), TX_ID)?;
        let time = self.choice.time.as_ref().map(|name| self.chosen("--time", name)).transpose()?;
        Ok(id.into_iter().chain(time).collect())
    }
}

/// Lists the first [`SHOWN`] names, and the number of the others.
pub(super) fn list<'a>(names: impl IntoIterator<Item = &'a str>) -> String {
    let mut names = names.into_iter();
    let mut shown: Vec<String> = names.by_ref().take(SHOWN).map(quoted).collect();
    let others = names.count();
    shown.extend((others > 0).then(|| format!("and {others} more")));
    shown.join(", ")
}
