use super::names::Affixes;
use super::*;
use crate::TableFile;
use flate2::{Compression, write::GzEncoder};
use pwrfgs_core::PowerUnit;
use std::fmt::Write as _;
use std::io::Write as _;

/// Returns the table `text` called `name`.
fn file(name: &str, text: &str) -> TableFile {
    TableFile { path: name.into(), bytes: Some(text.as_bytes().to_vec()) }
}

/// Reads `text` as a table called `survey.csv`.
fn read(text: &str, import: TableImport) -> Result<ImportedTable, String> {
    read_all(TableImport { files: vec![file("survey.csv", text)], ..import })
}

fn read_all(import: TableImport) -> Result<ImportedTable, String> {
    TableImport { title: "hall".into(), ..import }.read(&|_, _| {}).map_err(|e| e.to_string())
}

/// Returns position, receiver and power of each link, rounded to thousandths.
fn links(imported: &ImportedTable) -> Vec<([f64; 3], &str, f64)> {
    let (data, round) = (&imported.data, |v: f64| (v * 1e3).round() / 1e3);
    let link = |i: usize| {
        let sample = data.sample(i);
        let name = &*data.scene.receivers[sample.receiver].name;
        (sample.position().map(round), name, round(data.image(i).pixels[0] as f64))
    };
    (0..data.len()).map(link).collect()
}

fn powers(imported: &ImportedTable) -> Vec<f64> {
    links(imported).into_iter().map(|(.., dbm)| dbm).collect()
}

fn columns(change: impl FnOnce(&mut ColumnChoice)) -> TableImport {
    let mut import = TableImport::default();
    change(&mut import.columns);
    import
}

const LONG: &str = "x,y,z,receiver,rx_x,rx_y,rx_z,dbm\n0,0,1.2,a,0,0,2.5,-42.9\n0,2,1.2,b,8,0,2.5,-59.2\n";

#[test]
fn all_dialects_of_one_table_give_equal_links() {
    let expected = vec![([0.0, 0.0, 1.2], "a", -42.9), ([0.0, 2.0, 1.2], "b", -59.2)];
    let dialects = [
        LONG.to_owned(),
        LONG.replace(',', ";").replace('.', ","),
        LONG.replace(',', "\t"),
        LONG.replace(',', "\t").replace('.', ","),
        LONG.replace(',', " "),
        LONG.replace('\n', "\r\n"),
        LONG.replace('\n', "\r"),
        format!("\u{feff}{LONG}"),
        format!("# survey of floor 2\n# 2024-05-01\n{LONG}"),
        format!("#{LONG}"),
        format!("WigleWifi-1.4,appRelease=1,model=x\n{LONG}"),
        LONG.replace("x,y,z", "\"X [m]\",\"Y (m)\",Height"),
        LONG.replace("x,y,z", "pos_x_m,pos_y_m,z_metres"),
        format!("{LONG}4,4,1.2,a,0,0,2.5,NaN\n4,4,1.2,b,8,0,2.5,\n4,2,1.2,b,8,0,2.5,NA\n4,6,1.2,b,8,0,2.5,-\n"),
        format!("{LONG}4,4,1.2,a,0,0,2.5,null\n4,4,1.2,a,1e-7,0,2.5,none\n"),
    ];
    for text in dialects {
        let imported = read(&text, TableImport::default()).unwrap_or_else(|e| panic!("{text}: {e}"));
        assert_eq!(links(&imported), expected, "{text}");
        let receiver = &imported.data.scene.receivers[1];
        assert_eq!((receiver.pose.position, receiver.is_estimated), ([8.0, 0.0, 2.5], false), "{text}");
    }
    let mut gzip = GzEncoder::new(Vec::new(), Compression::default());
    gzip.write_all(LONG.as_bytes()).unwrap();
    let bytes = Some(gzip.finish().unwrap());
    let files = vec![TableFile { path: "a.csv.gz".into(), bytes }];
    assert_eq!(links(&read_all(TableImport { files, ..TableImport::default() }).unwrap()), expected);
}

#[test]
fn columns_without_header_are_chosen_by_number() {
    let rows = "0 0 -42.5\n0 2 -59.5\n";
    let import = |name: Option<&str>| {
        columns(|c| {
            (c.x, c.y, c.power, c.receiver) =
                (Some("1".into()), Some("2".into()), Some("3".into()), name.map(str::to_owned));
        })
    };
    let imported = read(rows, import(Some("007"))).unwrap();
    assert_eq!(links(&imported), [([0.0, 0.0, 0.0], "007", -42.5), ([0.0, 2.0, 0.0], "007", -59.5)]);
    // A file per receiver: receivers from the file names.
    let files = vec![file("d/ap1.txt", rows), file("d/ap2.txt", "0 0 -70\n")];
    let imported = read_all(TableImport { files, ..import(None) }).unwrap();
    assert_eq!(links(&imported), [([0.0; 3], "ap1", -42.5), ([0.0; 3], "ap2", -70.0), ([0.0, 2.0, 0.0], "ap1", -59.5)]);
    let error = read(rows, TableImport::default()).unwrap_err();
    assert!(error.contains("no position was recognised") && error.contains("--places"), "{error}");
}

#[test]
fn columns_may_have_the_names_of_receivers_within_a_shared_text() {
    let read_with = |table: &str, receivers: &str| {
        read(table, TableImport { receivers: Some(file("receivers.csv", receivers)), ..TableImport::default() })
    };
    let table = "x,y,RSSI_AP1,RSSI_AP11\n0,0,-40,-50\n1,0,-41,-51\n";
    let imported = read_with(table, "name,x,y,z\nAP11,5,0,2\nAP1,3,0,2\nAP2,9,9,2\n").unwrap();
    let positions: Vec<_> = imported
        .data
        .scene
        .receivers
        .iter()
        .map(|receiver| (&*receiver.name, receiver.pose.position, receiver.is_estimated))
        .collect();
    assert_eq!(positions, [("AP1", [3.0, 0.0, 2.0], false), ("AP11", [5.0, 0.0, 2.0], false)]);
    assert_eq!(powers(&imported), [-40.0, -50.0, -41.0, -51.0]);
    let notes = imported.notes.join("\n");
    assert!(notes.contains("column `RSSI_AP1` is receiver `AP1`, and so on"), "{notes}");
    assert!(notes.contains("height 0 m (set --height METRES)"), "{notes}");
    // A name is whole, whatever its case; columns may be the names themselves; one may have no position.
    let names = |columns: &[&str], placed: &[&str]| -> Option<Vec<String>> {
        let affixes = Affixes::find(columns, placed)?;
        columns.iter().map(|column| affixes.strip(column).map(str::to_owned)).collect()
    };
    let four = ["AP1", "AP11", "AP2", "AP21"];
    assert_eq!(names(&["AP11", "AP21"], &four), None);
    assert_eq!(names(&["11", "21"], &["1", "2"]), None, "a number is not divided");
    assert_eq!(names(&["RSSI_AP11", "RSSI_AP21"], &four).unwrap(), ["AP11", "AP21"]);
    assert_eq!(names(&["RSSI_AP11"], &four).unwrap(), ["AP11"]);
    assert_eq!(names(&["rssi_ap1", "rssi_ap2"], &four).unwrap(), ["ap1", "ap2"]);
    assert_eq!(names(&["RSSI_S", "RSSI_T"], &["S", "T"]).unwrap(), ["S", "T"]);
    assert_eq!(names(&["AP1 [dBm]", "AP5 [dBm]"], &four).unwrap(), ["AP1", "AP5"]);
    assert_eq!(names(&["signal", "noise"], &["al", "is"]), None, "a word is not divided");
    let problem = read_with(table, "name,x,y,z\nkitchen,5,0,2\n").err().unwrap();
    assert!(
        problem.contains("has the names `kitchen`, but the powers are those of `RSSI_AP1`, `RSSI_AP11`"),
        "{problem}"
    );
}

#[test]
fn wide_columns_are_recognised_or_chosen() {
    let wide =
        "FloorID,X,Y,UserID,MAC1,MAC2,MAC10,RTT1,RTT2\n1,0,0,7,-40,-50,100,1500,2100\n1,0,3,7,100,-55,100,1700,900\n";
    let missing = TableImport { missing: vec![100.0], ..TableImport::default() };
    let imported = read(wide, missing.clone()).unwrap();
    assert_eq!(
        links(&imported),
        [([0.0; 3], "MAC1", -40.0), ([0.0; 3], "MAC2", -50.0), ([0.0, 3.0, 0.0], "MAC2", -55.0)]
    );
    let notes = imported.notes.join("\n");
    for note in [
        "powers of 3 receivers in columns: `MAC1`, `MAC2`, `MAC10`",
        "not used: `UserID`, `RTT1`, `RTT2`",
        "3 cells are 100, not received",
        "1 receivers received nothing and are left out: `MAC10`",
    ] {
        assert!(notes.contains(note), "{note}: {notes}");
    }
    assert!(imported.data.scene.receivers.iter().all(|receiver| receiver.is_estimated));
    let names = "x,y,kitchen,Lab,101\n0,0,-40,-50,-60\n0,1,-41,,-61\n";
    let imported = read(names, TableImport::default()).unwrap();
    assert_eq!(powers(&imported), [-40.0, -50.0, -60.0, -41.0, -61.0]);
    let chosen = TableImport {
        columns: ColumnChoice { wide: vec!["l*".into(), "10?1".into()], ..ColumnChoice::default() },
        ..TableImport::default()
    };
    assert!(read(names, chosen).unwrap_err().contains("--columns 10?1: no column has such a name"));
    let chosen = TableImport {
        columns: ColumnChoice { wide: vec!["l*".into(), "1*1".into()], ..ColumnChoice::default() },
        ..TableImport::default()
    };
    assert_eq!(powers(&read(names, chosen).unwrap()), [-50.0, -60.0, -61.0]);
    let two = "x,y,a1,a2,b1,b2\n0,0,-40,-50,-3,-4\n0,1,-41,-52,-2,-1\n";
    assert!(
        read(two, TableImport::default())
            .unwrap_err()
            .contains("`a1` .. and `b1` .. could each be the received powers")
    );
}

/// A column of powers under another name stands beside the names of the receivers.
#[test]
fn only_column_of_powers_is_that_of_all_receivers() {
    for header in ["x,y,bssid,level", "x,y,AP,value", "x,y,station,dB"] {
        let imported = read(&format!("{header}\n0,0,a,-40\n0,0,b,-50\n"), TableImport::default()).unwrap();
        assert_eq!(links(&imported), [([0.0; 3], "a", -40.0), ([0.0; 3], "b", -50.0)], "{header}");
    }
}

#[test]
fn degrees_become_metres() {
    let text = "latitude,longitude,gw,power\n48.137,11.575,a,-40\n48.137054,11.575,a,-50\n48.137,11.575108,a,-60\n";
    let imported = read(text, TableImport::default()).unwrap();
    let data = &imported.data;
    let positions: Vec<[f64; 3]> = data.locations.iter().map(pwrfgs_core::Location::position).collect();
    let [north, east] = [positions[1][1] - positions[0][1], positions[2][0] - positions[0][0]];
    assert!((north - 6.005).abs() < 0.01 && (east - 8.04).abs() < 0.02, "{north} {east}");
    let zero = data.scene.geodetic.unwrap();
    assert_eq!([zero.latitude, zero.longitude], [48.14, 11.58]);
    let [latitude, longitude] = zero.degrees([positions[0][0], positions[0][1]]);
    assert!((latitude - 48.137).abs() < 1e-12 && (longitude - 11.575).abs() < 1e-12);
    // Longitude first, and columns called x and y.
    let exchanged = text.replace("latitude,longitude", "y,x");
    let error = read(&exchanged, TableImport::default()).unwrap_err();
    assert!(error.contains("look like degrees; add --lat-lon"), "{error}");
    let chosen = TableImport { is_lat_lon: true, ..columns(|c| (c.lat, c.lon) = (Some("y".into()), Some("x".into()))) };
    assert_eq!(links(&read(&exchanged, chosen).unwrap()), links(&imported));
    // Metres of a national grid under these names.
    let grid = "LONGITUDE,LATITUDE,WAP001,WAP002\n-7541.26,4864920.8,-93,-80\n-7536.6,4864934.2,-90,-70\n";
    let imported = read(grid, TableImport::default()).unwrap();
    assert_eq!(links(&imported)[0].0, [-7541.26, 4_864_920.8, 0.0]);
    let wrong = text.replace("48.137,11", "91.5,11");
    assert!(
        read(&wrong, TableImport { is_lat_lon: true, ..TableImport::default() })
            .unwrap_err()
            .contains("no place on the Earth")
    );
}

#[test]
fn repeated_readings_have_a_location_each() {
    let text = "x,y,ap,rssi\n0,0,a,-40\n0,0,A,-42\n0,0.0004,b,-50\n5,0,a,-60\n";
    let imported = read(text, TableImport::default()).unwrap();
    let origin = [0.0; 3];
    assert_eq!(
        links(&imported),
        [(origin, "a", -40.0), (origin, "b", -50.0), (origin, "a", -42.0), ([5.0, 0.0, 0.0], "a", -60.0)]
    );
    let notes = imported.notes.join("\n");
    for note in [
        "1 readings repeat a link",
        "1 positions are within 1 mm",
        "1 receiver names differ from another only by case and are joined: `A`",
    ] {
        assert!(notes.contains(note), "{note}: {notes}");
    }
    // Marks of text direction are no part of a name.
    let marked = read("x,y,ap,rssi\n0,0,\u{202a}a,-40\n5,0,\u{202a}a,-60\n", TableImport::default()).unwrap();
    assert!(!marked.notes.join("\n").contains("only by case"), "{:?}", marked.notes);
    // With their times, the readings of one moment are one location.
    let timed = "x,y,ap,rssi,t\n0,0,a,-40,1\n0,0,a,-42,2\n0,0,b,-50,2\n";
    let imported = read(timed, columns(|c| c.time = Some("t".into()))).unwrap();
    assert_eq!(imported.data.links.iter().map(|link| link.location).collect::<Vec<_>>(), [0, 1, 1]);
}

#[test]
fn other_files_state_places_receivers_and_test_set() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        Some(TableFile::from(path.into_os_string()))
    };
    let rooms = "cell,b1,b2\nO02,-60,-200\nP01,-70,-71\nO02,-61,-200\n";
    let import = TableImport {
        places: write("places.csv", "cell;x;y\nO02;1,5;2\nP01;3;4\n"),
        receivers: write("beacons.csv", "name,x,y,z\nb1,9,9,3\nb3,0,0,3\n"),
        missing: vec![-200.0],
        height: Some(1.0),
        ..TableImport::default()
    };
    let imported = read(rooms, import.clone()).unwrap();
    let (o02, p01) = ([1.5, 2.0, 1.0], [3.0, 4.0, 1.0]);
    assert_eq!(links(&imported), [(o02, "b1", -60.0), (p01, "b1", -70.0), (p01, "b2", -71.0), (o02, "b1", -61.0)]);
    let receivers = &imported.data.scene.receivers;
    assert_eq!((receivers[0].pose.position, receivers[0].is_estimated), ([9.0, 9.0, 3.0], false));
    assert_eq!((receivers[1].pose.position, receivers[1].is_estimated), (p01, true));
    let error = read("cell,b1\nO02,-60\nP9,-70\n", import).unwrap_err();
    assert!(error.contains("no column holds only names of --places"), "{error}");

    let tx = write("tx.txt", "# x y z\n1 2 3\n4 5 6\n");
    let imported = read("a1,a2\n-40,-50\n-45,\n", TableImport { tx: tx.clone(), ..TableImport::default() }).unwrap();
    assert_eq!(links(&imported)[2], ([4.0, 5.0, 6.0], "a1", -45.0));
    let error = read("a1,a2\n-40,-50\n", TableImport { tx, ..TableImport::default() }).unwrap_err();
    assert!(error.contains("the file of --tx has more rows"), "{error}");
    // Latitude is the first column without a header, too.
    let import = TableImport { tx: write("degrees.txt", "48.137 11.575\n48.138 11.575\n"), ..TableImport::default() };
    let imported = read("a1,a2\n-40,-50\n-45,-55\n", TableImport { is_lat_lon: true, ..import }).unwrap();
    assert_eq!(imported.data.scene.geodetic.unwrap().latitude, 48.14);

    let [training, test] =
        [file("a.csv", "x,y,w1,w2\n0,0,-40,-50\n"), file("b.csv", "x,y,w1,w2\n0,0,-41,-51\n2,0,-45,-55\n")];
    let imported = read_all(TableImport { files: vec![training], test: vec![test], ..TableImport::default() }).unwrap();
    assert_eq!(imported.data.official, Some((vec![0, 1], vec![2, 3, 4, 5])));
}

#[test]
fn header_may_begin_as_an_archive_does() {
    let imported = read("PK,x,y,w1,w2\n7,0,0,-40,-50\n8,1,0,-41,-51\n", TableImport::default()).unwrap();
    assert_eq!(powers(&imported), [-40.0, -50.0, -41.0, -51.0]);
}

#[test]
fn chosen_columns_are_not_powers() {
    let text = "x,y,level,nr,roof,hall\n0,0,1,7,-40,-50\n1,0,1,8,-41,-51\n";
    let import = columns(|c| (c.floor, c.tx_id) = (Some("level".into()), Some("nr".into())));
    assert_eq!(powers(&read(text, import).unwrap()), [-40.0, -50.0, -41.0, -51.0]);
}

#[test]
fn floors_need_a_height() {
    let text = "x,y,floor,w1,w2\n0,0,0,-40,-50\n0,0,2,-41,-51\n";
    assert!(
        read(text, TableImport::default())
            .unwrap_err()
            .contains("has the floors `0`, `2`; give their height with --floor-height")
    );
    let import = TableImport { floor_height: Some(3.5), height: Some(1.0), ..TableImport::default() };
    let imported = read(text, import).unwrap();
    assert_eq!(links(&imported)[2].0, [0.0, 0.0, 8.0]);
    let floors = &imported.data.scene.floors;
    assert_eq!(floors.iter().map(|(name, z)| (&**name, *z)).collect::<Vec<_>>(), [("0", 1.0), ("2", 8.0)]);
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("saved");
    let saved = crate::save(&imported.data, &out).unwrap().load(Path::new(""), &|_, _| {}).unwrap();
    assert_eq!(&saved.scene.floors, floors);
    let manifest = std::fs::read_to_string(out.join("manifest.json")).unwrap();
    assert!(manifest.replace([' ', '\n'], "").contains(r#""floors":{"0":1.0,"2":8.0}"#), "{manifest}");
    let one = read(&text.replace(",2,", ",0,"), TableImport::default()).unwrap();
    assert_eq!(links(&one)[2].0, [0.0; 3]);
}

#[test]
fn units_become_dbm() {
    let text =
        |values: [&str; 3]| format!("x,y,ap,power\n0,0,a,{}\n0,1,a,{}\n0,2,a,{}\n", values[0], values[1], values[2]);
    let cases = [
        ("dBm", ["-40", "-50", "-100"], vec![-40.0, -50.0, -100.0]),
        ("positive-dBm", ["40", "50", "100"], vec![-40.0, -50.0, -100.0]),
        ("percent", ["100", "50", "0"], vec![-50.0, -75.0, -100.0]),
        ("dB:-95", ["0", "20", "55"], vec![-95.0, -75.0, -40.0]),
        ("mW", ["1e-4", "1e-5", "0"], vec![-40.0, -50.0]),
        ("W", ["1e-7", "1e-8", "0"], vec![-40.0, -50.0]),
    ];
    for (unit, values, expected) in cases {
        let import = TableImport { unit: unit.parse().unwrap(), ..TableImport::default() };
        assert_eq!(powers(&read(&text(values), import).unwrap()), expected, "{unit}");
    }
    assert!("dB".parse::<PowerUnit>().unwrap_err().contains("dB:FLOOR"));
    let error = read(&text(["400", "1", "2"]), TableImport::default()).unwrap_err();
    assert!(error.contains("survey.csv:2:7: the power is 400, no power in dBm; give dBm, or set --unit"), "{error}");
}

#[test]
fn refuses_what_it_cannot_know() {
    let cases = [
        ("x,y,rssi,rsrp\n0,0,-40,-50\n", "`rssi`, `rsrp` could each be the column of --power; name one with --power"),
        (
            "x,y,rssi,rssi2\n0,0,-40,-50\n",
            "`rssi`, `rssi2` could each be the power; name one with --power, or those of all",
        ),
        ("x,y,lat,lon,rssi\n0,0,48.1,11.5,-40\n", "`x`, `y` and `lat`, `lon` could each be the position"),
        ("x,y,ap,mac,rssi\n0,0,a,b,-40\n", "could each be the column of --receiver; name one with --receiver"),
        ("X [mm],Y [mm],rssi\n0,0,-40\n", "`X [mm]` is not in metres; convert the column"),
        (
            "x,y,ssid,rssi\n0,0,a,-40\n0,0,b,-50\n0,1,a,-40\n0,1,b,-50\n",
            "`ssid` may be the column of the receivers; name it with --receiver",
        ),
        ("x,y,ap,rssi\n", "has a header but no row; write one row per reading"),
        ("x,rssi\n0,-40\n", "only one coordinate of the position was recognised"),
        ("time,ap,rssi\n1,a,-40\n", "that share only the time must be joined first"),
        ("x,y,ap,rssi\n0,0,a,[-40 -41]\n", "survey.csv:2:7: `[-40 -41]` is a list; write one row per reading"),
        ("x,y,ap,rssi\n0,0,a,loud\n", "survey.csv:2:7: `loud` is not a number; give the power as a number"),
        ("x,y,ap,rssi\n,0,a,-40\n", "survey.csv:2:1: no coordinate; give every row a position"),
        ("x,y,ap,rssi\n1e9,0,a,-40\n", "survey.csv:2:1: a coordinate is 1e9 m, beyond 1e8 m"),
        ("x,y,ap,rssi\n0,0,a,-40,1\n", "survey.csv:2:11: the row has 5 fields, its header 4"),
        ("x,y,ap,rssi\n0,0,a,\n", "holds no received power"),
        ("x,y,name\n0,0,a\n", "no column of received powers was recognised among `x`, `y`, `name`"),
        ("PK\u{3}\u{4}sheet", "is an archive, as .xlsx is; save the sheet as CSV"),
        ("", "holds no row"),
    ];
    for (text, message) in cases {
        let error = read(text, TableImport::default()).unwrap_err();
        assert!(error.contains(message), "{error}");
    }
    let bomb = {
        let mut gzip = GzEncoder::new(Vec::new(), Compression::best());
        let block = vec![b'1'; 1 << 20];
        (0..257).for_each(|_| gzip.write_all(&block).unwrap());
        TableFile { path: "bomb.gz".into(), bytes: Some(gzip.finish().unwrap()) }
    };
    let error = read_all(TableImport { files: vec![bomb], ..TableImport::default() }).unwrap_err();
    assert!(error.contains("expands beyond the limit"), "{error}");
}

#[test]
fn preview_shows_ten_rows_before_and_after() {
    let mut text = "x,y,ap,rssi\n".to_owned();
    (0..30).for_each(|k| writeln!(text, "{k},1,a,{}", -40 - k).unwrap());
    let imported = read(&text, TableImport::default()).unwrap();
    assert_eq!((imported.before.len(), imported.after.len()), (11, 10));
    assert_eq!((&*imported.before[1], &*imported.after[0]), ("0,1,a,-40", "(0.000, 1.000, 0.000) m: a -40 dBm"));
}
