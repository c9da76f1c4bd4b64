//! Names under which people write the columns of tables.

use crate::text::split_unit;
use std::collections::{BTreeSet, HashSet};

/// Coordinates across, metres.
pub(super) const X: &str = "x xm xmeters xmetres xpos xposm posx posxm xcoord coordx xcoordinate xposition positionx locx txx \
    uex east easting ecoord";
/// Coordinates along, metres.
pub(super) const Y: &str = "y ym ymeters ymetres ypos yposm posy posym ycoord coordy ycoordinate yposition positiony locy txy \
    uey north northing ncoord";
/// Heights, metres.
pub(super) const Z: &str = "z zm zmeters zmetres zpos zposm posz poszm zcoord coordz zposition positionz locz txz \
    uez height heightm alt altitude altitudem altitudemeters elevation hcoord";
/// Latitudes.
pub(super) const LAT: &str = "lat latitude gpslat gpslatitude currentlatitude latdeg txlat";
/// Longitudes.
pub(super) const LON: &str = "lon lng long longitude gpslon gpslng gpslong gpslongitude currentlongitude londeg txlon";
/// Floors.
pub(super) const FLOOR: &str = "floor floorid storey floornumber";
/// Transmitters.
pub(super) const TX_ID: &str = "tx txid transmitter transmitterid";
/// Receivers.
pub(super) const RECEIVER: &str = "receiver receiverid rx rxid gateway gatewayid gw gwid ap apid bssid mac macaddress \
    anchor anchorid beacon beaconid router station basestation cell cellid pci";
/// Places.
pub(super) const PLACE: &str = "name place location point";
/// Received powers.
pub(super) const POWER: &str = "dbm power powerdbm rssi rssidbm rss rsrp rsrpdbm rxpower receivedpower signal signalstrength \
    signaldbm prx";
/// Columns that are neither positions nor powers.
pub(super) const OTHER: &str = "id index row no number time timestamp date datetime firstseen user userid phone phoneid scene \
    sceneid building buildingid space spaceid relativeposition sampletimes samples count channel \
    frequency snr accuracy accuracymeters speed heading battery";

/// Returns a column name in lower case, without units in brackets, blanks and marks.
pub(super) fn normalised_name(name: &str) -> String {
    split_unit(name).0.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// Returns whether a normalised name is one of `names`, which blanks separate.
pub(super) fn is_one_of(name: &str, names: &str) -> bool {
    names.split(' ').any(|other| other == name)
}

/// Text that columns have before and after the names of their receivers, such as `RSSI_` and nothing in `RSSI_AP1`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Affixes {
    before: String,
    after: String,
}

impl Affixes {
    /// Finds the text that all `columns` have before and after the names of their receivers, in either case: the one that
    /// leaves the most names of `placed`, the receivers of known position. Its ends at a name divide no word or number. `None`
    /// without such a text, or if a column is itself in `placed`.
    pub(super) fn find(columns: &[&str], placed: &[&str]) -> Option<Self> {
        let lower = |names: &[&str]| names.iter().map(|name| name.to_ascii_lowercase()).collect::<Vec<_>>();
        let (columns, placed) = (lower(columns), lower(placed));
        let names: HashSet<&str> = placed.iter().map(String::as_str).collect();
        if columns.iter().any(|column| names.contains(column.as_str())) {
            return None;
        }
        let pairs = columns.iter().flat_map(|column| placed.iter().map(move |name| (column, name)));
        let candidates: BTreeSet<Self> = pairs.flat_map(|(column, name)| Self::around(column, name)).collect();
        let count = |affixes: &Self| -> Option<usize> {
            let inner: Option<Vec<&str>> = columns.iter().map(|column| affixes.strip(column)).collect();
            Some(inner?.into_iter().filter(|name| names.contains(name)).count())
        };
        let counted = candidates.into_iter().filter_map(|affixes| Some((count(&affixes)?, affixes)));
        counted.max_by_key(|(count, _)| *count).map(|(_, affixes)| affixes)
    }

    /// Returns the text around each occurrence of `name` in `column` that divides no word or number.
    fn around(column: &str, name: &str) -> Vec<Self> {
        let splits = column.match_indices(name).map(|(at, _)| (&column[..at], &column[at + name.len()..]));
        let is_whole = |(before, after): &(&str, &str)| !is_divided(before, name) && !is_divided(name, after);
        splits.filter(is_whole).map(|(before, after)| Self { before: before.into(), after: after.into() }).collect()
    }

    /// Returns the name inside a column; `None` if the column lacks the text, or has nothing else.
    pub(super) fn strip<'c>(&self, column: &'c str) -> Option<&'c str> {
        let (start, end) = (self.before.len(), column.len().checked_sub(self.after.len())?);
        let is_same = |part: Option<&str>, text: &str| part.is_some_and(|part| part.eq_ignore_ascii_case(text));
        let has_text = is_same(column.get(..start), &self.before) && is_same(column.get(end..), &self.after);
        column.get(start..end).filter(|name| has_text && !name.is_empty())
    }
}

/// Returns whether two texts side by side divide a word or a number.
fn is_divided(left: &str, right: &str) -> bool {
    let (Some(last), Some(first)) = (left.chars().last(), right.chars().next()) else { return false };
    (last.is_alphabetic() && first.is_alphabetic()) || (last.is_numeric() && first.is_numeric())
}
