//! Names under which people write the columns of tables.

use crate::text::split_unit;
use std::collections::HashSet;

/// Coordinates across, metres.
pub(super) const X: &str =
    "x xm xpos posx xcoord coordx xcoordinate xposition positionx locx txx uex east easting ecoord";
/// Coordinates along, metres.
pub(super) const Y: &str =
    "y ym ypos posy ycoord coordy ycoordinate yposition positiony locy txy uey north northing ncoord";
/// Heights, metres.
pub(super) const Z: &str = "z zm zpos posz zcoord coordz zposition positionz locz txz uez height heightm alt altitude altitudem \
    altitudemeters elevation hcoord";
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

/// Returns whether a normalised name is one of a list of names.
pub(super) fn is_one_of(name: &str, names: &str) -> bool {
    names.split(' ').any(|other| other == name)
}

/// Returns column names without the text that all have before and after a name of `placed`, such as `RSSI_` in `RSSI_AP1`;
/// `None` if that does not make each a name of `placed`.
pub(super) fn strip_shared<'c>(columns: &[&'c str], placed: &[&str]) -> Option<Vec<&'c str>> {
    let names: HashSet<&str> = placed.iter().copied().collect();
    let first = columns.first()?;
    placed.iter().find_map(|name| {
        let (before, after) = first.split_once(name)?;
        let inner = |column: &&'c str| column.strip_prefix(before)?.strip_suffix(after);
        columns.iter().map(|column| inner(column).filter(|name| names.contains(name))).collect()
    })
}
