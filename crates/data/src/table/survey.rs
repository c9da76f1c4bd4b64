//! `Survey`: collects readings from tables and makes a data set of them.

use super::columns::{ColumnSearch, PowerColumns};
use super::dialect::TableText;
use super::places::{Frame, Places, distance, read_named, read_rows};
use super::{ImportedTable, TableFile, TableImport};
use crate::checks::power_fault;
use crate::text::{TextField, TextRow};
use pwrfgs_core::messages::{quoted, strip_control};
use pwrfgs_core::{Dataset, Error, Link, Location, Pose, Real, Receiver, Result, Simulation};
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Number of rows in a preview, of receivers in its rows, and of names in a list.
const PREVIEW: usize = 10;
const SHOWN: usize = 5;
/// Distance above which a receiver has two positions, metres.
const SAME_M: f64 = 1e-3;

/// Power of a link.
#[derive(Clone, Copy)]
struct Reading {
    location: u32,
    receiver: u32,
    dbm: Real,
}

/// Transmitter, or one of its repeated readings.
#[derive(Clone, Copy)]
struct Spot {
    /// Index of the position.
    place: u32,
    is_test: bool,
}

/// Receiver under its first spelling.
struct NamedReceiver {
    name: String,
    position: Option<[f64; 3]>,
}

/// Readings so far.
pub(super) struct Survey<'a> {
    import: &'a TableImport,
    frame: Frame,
    /// Positions by the name of a place, if the rows name places.
    named: BTreeMap<String, [f64; 3]>,
    /// Positions row by row, if they are in another file.
    rows: Option<std::vec::IntoIter<[f64; 3]>>,
    places: Places,
    spots: Vec<Spot>,
    /// Location of each group of rows (place, cells of the transmitter, test set) and each repetition.
    groups: HashMap<(u32, String, bool, u32), u32>,
    /// Number of readings of a group at a receiver.
    repetitions: HashMap<(u32, String, bool, u32), u32>,
    receivers: Vec<NamedReceiver>,
    receiver_indices: HashMap<String, u32>,
    readings: Vec<Reading>,
    floors: BTreeSet<String>,
    /// Spellings of receiver names that were joined with another one.
    respelled: BTreeSet<String>,
    /// Number of cells with each code for "not heard".
    coded: Vec<usize>,
    silent: usize,
    repeated: usize,
    notes: Vec<String>,
    before: Vec<String>,
}

impl<'a> Survey<'a> {
    /// Creates a survey; reads the files of places, rows and receivers.
    pub(super) fn new(import: &'a TableImport) -> Result<Self> {
        let mut frame = Frame::default();
        let named = import.places.as_deref().map(|path| read_named(import, path, &mut frame)).transpose()?;
        let rows = import.tx.as_deref().map(|path| read_rows(import, path, &mut frame)).transpose()?;
        let placed = import.receivers.as_deref().map(|path| read_named(import, path, &mut frame)).transpose()?;
        let mut survey = Self {
            import,
            frame,
            named: named.unwrap_or_default(),
            rows: rows.map(Vec::into_iter),
            places: Places::default(),
            spots: Vec::new(),
            groups: HashMap::new(),
            repetitions: HashMap::new(),
            receivers: Vec::new(),
            receiver_indices: HashMap::new(),
            readings: Vec::new(),
            floors: BTreeSet::new(),
            respelled: BTreeSet::new(),
            coded: vec![0; import.missing.len()],
            silent: 0,
            repeated: 0,
            notes: Vec::new(),
            before: Vec::new(),
        };
        for (name, position) in placed.unwrap_or_default() {
            let receiver = survey.receiver(&name);
            survey.receivers[receiver as usize].position = Some(position);
        }
        Ok(survey)
    }

    /// Adds the readings of a table, of the test set or not.
    pub(super) fn add(&mut self, file: &TableFile, is_test: bool) -> Result<()> {
        let table = TableText::read(&file.path, file.bytes.clone())?;
        self.notes.push(table.describe());
        if self.before.is_empty() {
            self.before = table.head(PREVIEW);
        }
        let search = ColumnSearch::new(&table, &self.import.columns)?;
        let reader = RowReader::new(self, &table, &search)?;
        if matches!(reader.place, RowPlace::Columns(columns) if columns.looks_like_degrees(&search)) {
            let problem = "the positions look like degrees; add --lat-lon, or --lat COLUMN --lon COLUMN";
            return Err(Error::input(&file.path, problem));
        }
        self.notes.push(reader.describe(&search));
        match &reader.powers {
            PowerColumns::Long { .. } => self.add_long(&reader, is_test),
            PowerColumns::Wide(columns) => self.add_wide(&reader, columns, is_test),
        }
    }

    /// Adds a table with a row per transmitter.
    fn add_wide(&mut self, reader: &RowReader<'_>, columns: &[usize], is_test: bool) -> Result<()> {
        let names: Vec<u32> = columns.iter().map(|k| self.receiver(&reader.table.names[*k])).collect();
        for row in reader.table.rows() {
            let row = row?;
            let place = self.place(reader, &row)?;
            let location = self.spots.len() as u32;
            self.spots.push(Spot { place, is_test });
            for (&column, &receiver) in columns.iter().zip(&names) {
                // A row may end early: its last cells are empty.
                let Some(field) = row.fields.get(column) else { break };
                if let Some(dbm) = self.dbm(reader.table, &row, *field)? {
                    self.readings.push(Reading { location, receiver, dbm });
                }
            }
        }
        Ok(())
    }

    /// Adds a table with a row per reading. Readings of a group at one receiver that repeat have a location each.
    fn add_long(&mut self, reader: &RowReader<'_>, is_test: bool) -> Result<()> {
        let PowerColumns::Long { power, receiver, place: receiver_place } = reader.powers else { return Ok(()) };
        for row in reader.table.rows() {
            let row = row?;
            let place = self.place(reader, &row)?;
            let cell = |k: usize| row.cell((k, &reader.table.names[k]), "give every row all columns");
            let name = receiver.map_or(Ok(&*reader.receiver_name), |k| cell(k).map(|field| field.text))?;
            let receiver = self.receiver(name);
            if let Some(columns) = receiver_place {
                let position = self.frame.read(reader.table, &row, columns, self.import.height.unwrap_or(0.0))?;
                let known = self.receivers[receiver as usize].position.get_or_insert(position);
                if distance(*known, position) > SAME_M {
                    let problem = format!("receiver {} has another position in an earlier row", quoted(name));
                    return Err(row.fault(1, format!("{problem}; give one position per receiver")));
                }
            }
            let Some(dbm) = self.dbm(reader.table, &row, cell(power)?)? else { continue };
            let cells =
                reader.transmitter.iter().map(|k| cell(*k).map(|field| field.text)).collect::<Result<Vec<_>>>()?;
            let cells = cells.join("\u{1f}");
            let repetition = self.repetitions.entry((place, cells.clone(), is_test, receiver)).or_default();
            let group = (place, cells, is_test, *repetition);
            self.repeated += usize::from(*repetition > 0);
            *repetition += 1;
            let location = *self.groups.entry(group).or_insert_with(|| {
                self.spots.push(Spot { place, is_test });
                self.spots.len() as u32 - 1
            });
            self.readings.push(Reading { location, receiver, dbm });
        }
        Ok(())
    }

    /// Returns the place of a row.
    fn place(&mut self, reader: &RowReader<'_>, row: &TextRow<'_>) -> Result<u32> {
        let TableImport { height, floor_height, .. } = self.import;
        let mut height = height.unwrap_or(0.0);
        if let Some(column) = reader.floor {
            let field = row.cell((column, &reader.table.names[column]), "give every row a floor")?;
            let floor = reader.table.number(row, field, "floor")?.unwrap_or(0.0);
            self.floors.insert(field.text.to_owned());
            height += floor * floor_height.unwrap_or(0.0);
        }
        let position = match reader.place {
            RowPlace::Columns(columns) => self.frame.read(reader.table, row, columns, height)?,
            RowPlace::Name(column) => {
                let field = row.cell((column, &reader.table.names[column]), "give every row a place")?;
                *self.named.get(field.text).ok_or_else(|| {
                    row.fault(field.column, format!("{} is no place of --places; add it there", quoted(field.text)))
                })?
            }
            RowPlace::Next => {
                let next = self.rows.as_mut().and_then(Iterator::next);
                next.ok_or_else(|| row.fault(1, "the file of --tx has fewer rows; give a position per row"))?
            }
        };
        Ok(self.places.index(position))
    }

    /// Returns the index of a receiver; spellings that differ by case are one.
    fn receiver(&mut self, name: &str) -> u32 {
        let next = self.receivers.len() as u32;
        let index = *self.receiver_indices.entry(name.to_lowercase()).or_insert(next);
        if index == next {
            self.receivers.push(NamedReceiver { name: strip_control(name), position: None });
        } else if self.receivers[index as usize].name != name {
            self.respelled.insert(name.to_owned());
        }
        index
    }

    /// Returns the power in a cell, dBm; `None` if nothing was heard.
    fn dbm(&mut self, table: &TableText, row: &TextRow<'_>, field: TextField<'_>) -> Result<Option<Real>> {
        let Some(value) = table.number(row, field, "power")? else {
            self.silent += 1;
            return Ok(None);
        };
        if let Some(k) = self.import.missing.iter().position(|code| *code == value) {
            self.coded[k] += 1;
            return Ok(None);
        }
        let Some(dbm) = self.import.unit.dbm(value) else {
            self.silent += 1;
            return Ok(None);
        };
        power_fault(dbm).map_or(Ok(Some(dbm as Real)), |fault| {
            Err(row.fault(field.column, format!("the power {fault}, or set --unit")))
        })
    }

    /// Makes the data set. Returns an error if no power was received, or the floors have no height.
    pub(super) fn finish(mut self) -> Result<ImportedTable> {
        let path = &self.import.files.first().map(|file| file.path.clone()).unwrap_or_default();
        if self.rows.as_mut().is_some_and(|rows| rows.next().is_some()) {
            return Err(Error::input(
                path,
                "the file of --tx has more rows than the readings; give a position per row",
            ));
        }
        if self.floors.len() > 1 && self.import.floor_height.is_none() {
            let floors = list(self.floors.iter().map(String::as_str));
            return Err(Error::input(
                path,
                format!("has the floors {floors}; give their height with --floor-height METRES"),
            ));
        }
        if self.readings.is_empty() {
            let problem = "holds no received power; write one row per reading, or check --missing";
            return Err(Error::input(path, problem));
        }
        self.readings.sort_by_key(|reading| (reading.location, reading.receiver));
        let receivers = self.heard_receivers();
        self.describe(&receivers);
        let (locations, links) = self.number_links(&receivers);
        let powers: Vec<Real> = self.readings.iter().map(|reading| reading.dbm).collect();
        let is_test: Vec<bool> =
            self.readings.iter().map(|reading| self.spots[reading.location as usize].is_test).collect();
        let receivers: Vec<Receiver> = receivers.into_iter().flatten().collect();
        let mut data =
            Dataset::of_columns(&self.import.title, receivers.into(), vec![], locations, links, powers.into())?;
        let part = |test: bool| (0..is_test.len()).filter(|i| is_test[*i] == test).collect::<Vec<usize>>();
        data.official = (!self.import.test.is_empty()).then(|| (part(false), part(true)));
        data.estimate_receivers(&(0..data.len()).collect::<Vec<_>>());
        data.scene.geodetic = self.frame.geodetic;
        data.simulation = self.import.is_simulated.then(Simulation::default);
        let after = preview(&data);
        Ok(ImportedTable { data, notes: self.notes, before: self.before, after })
    }

    /// Returns the receivers, `None` for those that heard nothing. Those of unknown position stand at the first place.
    fn heard_receivers(&self) -> Vec<Option<Receiver>> {
        let mut is_heard = vec![false; self.receivers.len()];
        self.readings.iter().for_each(|reading| is_heard[reading.receiver as usize] = true);
        let place = |(receiver, is_heard): (&NamedReceiver, bool)| {
            let pose = Pose::from(receiver.position.unwrap_or(self.places.positions[0]));
            let named = Receiver { is_estimated: receiver.position.is_none(), ..Receiver::new(&*receiver.name, pose) };
            is_heard.then_some(named)
        };
        self.receivers.iter().zip(is_heard).map(place).collect()
    }

    /// Numbers the locations that were heard, from 0, and the receivers that heard one. Returns the columns of the data set.
    fn number_links(&self, receivers: &[Option<Receiver>]) -> (Vec<Location>, Vec<Link>) {
        let mut new_receivers = vec![0; receivers.len()];
        for (next, receiver) in (0..receivers.len()).filter(|r| receivers[*r].is_some()).enumerate() {
            new_receivers[receiver] = next;
        }
        let (mut locations, mut links, mut last) = (Vec::new(), Vec::with_capacity(self.readings.len()), None);
        for reading in &self.readings {
            if last != Some(reading.location) {
                let place = self.spots[reading.location as usize].place as usize;
                let pose = Pose::from(self.places.positions[place]);
                locations.push(Location { id: locations.len() as u32, pose });
                last = Some(reading.location);
            }
            links.push(Link { location: locations.len() - 1, receiver: new_receivers[reading.receiver as usize] });
        }
        (locations, links)
    }

    /// Notes what was joined, left out and assumed.
    fn describe(&mut self, receivers: &[Option<Receiver>]) {
        let mut sends = vec![false; self.spots.len()];
        self.readings.iter().for_each(|reading| sends[reading.location as usize] = true);
        let mut note = |count: usize, text: String| self.notes.extend((count > 0).then_some(text));
        for (code, count) in self.import.missing.iter().zip(&self.coded) {
            note(1, format!("{count} cells are {code}, not heard"));
        }
        note(self.silent, format!("{} cells are empty, not heard", self.silent));
        let deaf = self.receivers.iter().zip(receivers).filter(|(_, heard)| heard.is_none()).map(|(r, _)| &*r.name);
        let deaf: Vec<&str> = deaf.collect();
        note(
            deaf.len(),
            format!("{} receivers heard nothing and are left out: {}", deaf.len(), list(deaf.iter().copied())),
        );
        let unheard = sends.iter().filter(|sends| !**sends).count();
        note(unheard, format!("{unheard} rows were heard by no receiver and are left out"));
        note(
            self.repeated,
            format!("{} readings repeat a link: each has a location at the same position", self.repeated),
        );
        note(
            self.places.joined,
            format!("{} positions are within 1 mm of another and are joined with it", self.places.joined),
        );
        note(
            self.respelled.len(),
            format!(
                "{} receiver names differ from another only by case and are joined: {}",
                self.respelled.len(),
                list(self.respelled.iter().map(String::as_str))
            ),
        );
        let unknown = receivers.iter().flatten().filter(|receiver| receiver.is_estimated).count();
        note(
            unknown,
            format!(
                "the positions of {unknown} receivers are unknown and estimated from their strongest readings; --receivers FILE if they are known"
            ),
        );
        if let Some(zero) = self.frame.geodetic {
            note(
                1,
                format!(
                    "degrees become metres east and north of latitude {}, longitude {}",
                    zero.latitude, zero.longitude
                ),
            );
        }
    }
}

/// Position of a row.
enum RowPlace {
    Columns(super::columns::PlaceColumns),
    /// Column with the name of a place.
    Name(usize),
    /// Next row of another file.
    Next,
}

/// Columns of one table.
struct RowReader<'a> {
    table: &'a TableText,
    place: RowPlace,
    floor: Option<usize>,
    powers: PowerColumns,
    transmitter: Vec<usize>,
    /// Name of the receiver of a table without such a column.
    receiver_name: String,
}

impl<'a> RowReader<'a> {
    /// Recognises the columns of a table. Returns an error for missing or ambiguous columns.
    fn new(survey: &Survey<'_>, table: &'a TableText, search: &ColumnSearch<'_>) -> Result<Self> {
        let import = survey.import;
        let place = match (&survey.rows, &import.places) {
            (Some(_), _) => RowPlace::Next,
            (None, Some(_)) => {
                let column = search.named_places(&survey.named);
                RowPlace::Name(column.ok_or_else(|| search.fault("no column holds only names of --places; add the missing ones there"))?)
            }
            (None, None) => match search.place(import.is_lat_lon)? {
                Some(columns) => RowPlace::Columns(columns),
                None => return Err(search.fault(
                    "no position was recognised; name its columns with --x and --y or --lat and --lon, give the positions row by \
                     row with --tx FILE, or of places with --places FILE. Positions in another table that share only the time must be joined first",
                )),
            },
        };
        let has_height = matches!(place, RowPlace::Columns(columns) if columns.height.is_some());
        let floor = if has_height { None } else { search.floor()? };
        let used: Vec<usize> = match place {
            RowPlace::Columns(columns) => columns.plane.into_iter().chain(columns.height).chain(floor).collect(),
            RowPlace::Name(column) => vec![column],
            RowPlace::Next => Vec::new(),
        };
        let powers = search.powers(&used, import.is_lat_lon)?;
        let stem = table.path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        let is_one_of_many = import.files.len() > 1;
        let receiver_name = match (&import.columns.receiver, &powers) {
            (Some(name), _) => name.clone(),
            (None, PowerColumns::Long { power, .. }) if !is_one_of_many && table.header.is_some() => {
                table.names[*power].clone()
            }
            _ if is_one_of_many => stem,
            _ => "receiver".into(),
        };
        Ok(Self { table, place, floor, powers, transmitter: search.transmitter()?, receiver_name })
    }

    /// Describes the columns in one sentence, with those that are not used.
    fn describe(&self, search: &ColumnSearch<'_>) -> String {
        let mut used: Vec<usize> = self.floor.into_iter().chain(self.transmitter.iter().copied()).collect();
        let place = match self.place {
            RowPlace::Columns(columns) => {
                used.extend(columns.plane.into_iter().chain(columns.height));
                let unit = if columns.is_geodetic { "degrees" } else { "metres" };
                let height =
                    columns.height.map_or("no height".to_owned(), |k| format!("height in {}", search.list([k])));
                format!("positions in {} ({unit}), {height}", search.list(columns.plane))
            }
            RowPlace::Name(column) => {
                used.push(column);
                format!("places in {}", search.list([column]))
            }
            RowPlace::Next => "positions row by row from another file".into(),
        };
        let powers = match &self.powers {
            PowerColumns::Long { power, receiver, place } => {
                used.extend([*power].into_iter().chain(*receiver));
                used.extend(place.iter().flat_map(|place| place.plane.into_iter().chain(place.height)));
                let receiver = receiver.map_or_else(
                    || format!("of receiver {}", quoted(&self.receiver_name)),
                    |k| format!("at the receivers in {}", search.list([k])),
                );
                format!("powers in {} {receiver}", search.list([*power]))
            }
            PowerColumns::Wide(columns) => {
                used.extend(columns);
                let (first, last) = (columns.first().copied(), columns.last().copied());
                format!(
                    "powers of {} receivers in columns, {}",
                    columns.len(),
                    search.list(first.into_iter().chain(last))
                )
            }
        };
        let unused: Vec<&str> =
            (0..self.table.names.len()).filter(|k| !used.contains(k)).map(|k| &*self.table.names[k]).collect();
        let unused =
            if unused.is_empty() { String::new() } else { format!("; not used: {}", list(unused.iter().copied())) };
        format!("{place}; {powers}{unused}")
    }
}

/// Lists the first names.
fn list<'a>(names: impl Iterator<Item = &'a str> + Clone) -> String {
    let count = names.clone().count();
    let mut shown: Vec<String> = names.take(SHOWN).map(quoted).collect();
    shown.extend((count > SHOWN).then(|| format!("and {} more", count - SHOWN)));
    shown.join(", ")
}

/// Describes the first transmitters and their powers, a line each.
fn preview(data: &Dataset) -> Vec<String> {
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
