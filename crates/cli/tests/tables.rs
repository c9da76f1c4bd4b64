//! `pwrfgs import --table`: invented twins of public tables, with their dialects, each by one command of docs/data.md.

use crate::common::{call, refuse, stderr, stdout, succeed, write};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// Returns power in dBm at (x, y) of an access point at (ax, ay), rounded to whole numbers.
fn dbm(x: f64, y: f64, ax: f64, ay: f64) -> f64 {
    (-40.0 - 25.0 * (1.0 + (x - ax).hypot(y - ay)).log10()).round()
}

/// Writes a table of `header`, and a row for each of `count` places of a walk: `row` is given its number and x, y.
fn walk(path: &Path, header: &str, count: usize, row: impl Fn(usize, f64, f64) -> String) {
    let mut text = header.to_owned();
    for k in 0..count {
        let (x, y) = (0.7 * (k % 9) as f64, 0.9 * (k / 9) as f64);
        writeln!(text, "{}", row(k, x, y)).unwrap();
    }
    write(path, text);
}

/// Writes the twins.
fn write_twins(here: &Path) {
    let at = |k: usize, x: f64, y: f64, ap: usize, code: f64| {
        let heard = dbm(x, y, 3.0 * ap as f64, 2.0);
        if (k + ap).is_multiple_of(3) { code } else { heard }
    };
    // Power and round-trip time per access point; -200: not received; readings repeat at a place.
    let header = "X,Y,AP1-RTT(mm),AP1-RSS(dBm),AP2-RTT(mm),AP2-RSS(dBm),LOS APs\n";
    walk(&here.join("office.csv"), header, 36, |k, x, y| {
        format!("{x},{y},{},{},{},{},1 2", 1500 + k, at(k, x, y, 0, -200.0), 2200 + k, at(k, x, y, 1, -200.0))
    });
    // Wide, three floors, 100: not received, columns without a power, own test file.
    let header = "MAC1,MAC2,MAC3,MAC15,ECoord,NCoord,FloorID,BuildingID,SceneID,UserID,PhoneID,SampleTimes\n";
    let row = |k: usize, x: f64, y: f64| {
        let [a, b, c] = [0, 1, 2].map(|ap| at(k, x, y, ap, 100.0));
        format!("{a},{b},{c},100,{x},{y},{},1,2,3,4,30", 1 + k % 3)
    };
    walk(&here.join("training.csv"), header, 45, row);
    walk(&here.join("testing.csv"), header, 9, row);
    write(&here.join("aps.csv"), "MAC,X,Y,Z\nMAC1,0,2,3\nMAC2,3,2,3\n");
    // A walk in degrees; -100 dBm is a reading.
    walk(&here.join("campus.csv"), "latitude,longitude,altitude,rssi\n", 63, |k, x, y| {
        format!("{},{},{},{}", 41.17 + y * 1e-3, -8.6 + x * 1e-3, 100 + k % 3, -96 - (k % 9) as i32)
    });
    // Three gateways in degrees, 0: not received, the header begins with #.
    walk(&here.join("lorawan.csv"), "#lat,long,gw1,gw2,gw3\n", 45, |k, x, y| {
        let [a, b, c] = [0, 1, 2].map(|ap| at(k, x, y, ap, 0.0));
        format!("{},{},{a},{b},{c}", -23.5 + y * 1e-3, -46.6 + x * 1e-3)
    });
    // Beams of one cell.
    let beams: Vec<String> = (0..32).map(|beam| format!("beam_{beam}")).collect();
    walk(&here.join("beams.csv"), &format!("x,y,{}\n", beams.join(",")), 45, |_, x, y| {
        let powers: Vec<String> =
            (0..32).map(|beam| format!("{:.2}", dbm(x, y, 2.0, 2.0) - f64::from(beam % 7))).collect();
        format!("{x},{y},{}", powers.join(","))
    });
    // A file per router, tabs, no header; readings repeat.
    fs::create_dir_all(here.join("routers")).unwrap();
    for ap in 0..2_usize {
        walk(&here.join(format!("routers/router{ap}.txt")), "", 54, |k, x, _| {
            format!("{x}\t{}\t{}", k % 4, dbm(x, 1.0, 3.0 * ap as f64, 2.0) - (k % 2) as f64)
        });
    }
    // Semicolons, decimal commas, degrees.
    walk(&here.join("village.csv"), "device;snr;rssi;latitude;longitude\n", 40, |k, x, y| {
        format!("d{};{};{};{};{}", k % 2, k % 9, dbm(x, y, 0.0, 0.0), 44.8 + y * 1e-3, -0.5 + x * 1e-3)
            .replace('.', ",")
    });
    // Places are names of cells.
    let mut places = "cell,x,y\n".to_owned();
    (0..27).for_each(|k| writeln!(places, "{}{:02},{},{}", ["O", "P", "Q"][k % 3], k / 3, k % 3, k / 3).unwrap());
    write(&here.join("cells.csv"), places);
    walk(&here.join("beacons.csv"), "location,date,b3001,b3002\n", 54, |k, x, y| {
        let [a, b] = [0, 1].map(|ap| at(k, x, y, ap, -200.0));
        format!("{}{:02},10-18-2016 11:15:{:02},{a},{b}", ["O", "P", "Q"][k % 3], k / 3 % 9, k % 60)
    });
    // A line before the header, addresses in either case.
    let header = "WigleWifi-1.4,appRelease=2.26,model=x,release=9\nMAC,SSID,AuthMode,FirstSeen,Channel,RSSI,CurrentLatitude,\
                  CurrentLongitude,AltitudeMeters,AccuracyMeters,Type\n";
    walk(&here.join("wigle.csv"), header, 60, |k, x, y| {
        let mac = ["0a:00:00:00:00:01", "0A:00:00:00:00:01", "0a:00:00:00:00:02"][k % 3];
        let (rssi, latitude) = (dbm(x, y, 3.0 * (k % 3 / 2) as f64, 2.0), 52.5 + y * 1e-4);
        format!(
            "{mac},home,[WPA2],2026-11-01 10:00:{:02},6,{rssi},{latitude},{},34.0,3.9,WIFI",
            k % 60,
            13.4 + x * 1e-4
        )
    });
}

#[test]
fn twins_of_public_tables_need_one_command() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write_twins(here);
    let cases: [(&str, &str, &[&str]); 9] = [
        (
            "--table office.csv --missing -200",
            "48 received powers at 2 receivers",
            &["24 cells are -200", "not used: `AP1-RTT(mm)`"],
        ),
        (
            "--table training.csv --test testing.csv --receivers aps.csv --missing 100 --floor-height 4",
            "108 received powers at 3 receivers",
            &[
                "1 receivers received nothing and are left out: `MAC15`",
                "the positions of 1 of 3 receivers are unknown",
            ],
        ),
        (
            "--table campus.csv",
            "63 received powers in",
            &["(degrees), height in `altitude`; powers in `rssi` at `rssi`"],
        ),
        (
            "--table lorawan.csv --missing 0",
            "90 received powers at 3 receivers",
            &["header in line 1", "45 cells are 0"],
        ),
        (
            "--table beams.csv",
            "1,440 received powers at 32 receivers",
            &["powers of 32 receivers in columns: `beam_0`"],
        ),
        (
            "--table routers/router0.txt routers/router1.txt --x 1 --y 2 --power 3",
            "108 received powers at 2 receivers",
            &["no header: columns by number", "readings repeat a link"],
        ),
        (
            "--table village.csv --receiver roof",
            "40 received powers in",
            &["separated by `;`, decimal commas", "at `roof`"],
        ),
        (
            "--table beacons.csv --places cells.csv --missing -200",
            "72 received powers at 2 receivers",
            &["places in `location`"],
        ),
        (
            "--table wigle.csv",
            "60 received powers at 2 receivers",
            &["header in line 2", "differ from another only by case"],
        ),
    ];
    let documentation = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/data.md")).unwrap();
    for (k, (options, result, notes)) in cases.into_iter().enumerate() {
        assert!(documentation.contains(options), "docs/data.md lacks `{options}`");
        let out = format!("out{k}");
        let words: Vec<&str> = ["import"].into_iter().chain(options.split(' ')).chain(["--out", &out]).collect();
        let said = stderr(&succeed(here, &words));
        for note in [&[result], notes].concat() {
            assert!(said.contains(note), "{options}: {note}:\n{said}");
        }
        let text = stdout(&succeed(here, &["init", &out, "--out", &format!("{out}.ron")]));
        assert!(text.contains("next: pwrfgs run"), "{text}");
    }
}

#[test]
fn dry_run_writes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    write(&here.join("links.csv"), "x;y;ap;rssi\n0,5;1;a;-40\n1,5;1;a;-41\n");
    let shown = stdout(&succeed(here, &["import", "--table", "links.csv", "--dry-run"]));
    assert!(shown.contains("before:\n  x;y;ap;rssi\n  0,5;1;a;-40\n"), "{shown}");
    assert!(shown.contains("after:\n  (0.500, 1.000, 0.000) m: a -40 dBm\n"), "{shown}");
    assert_eq!(fs::read_dir(here).unwrap().count(), 1);
    // --links is the name of earlier versions.
    succeed(here, &["import", "--links", "links.csv", "--out", "hall", "--simulated"]);
    assert!(fs::read_to_string(here.join("hall/manifest.json")).unwrap().contains("\"simulated\": true"));
    refuse(here, &["import", "--table", "links.csv", "--out", "hall"], 2, &["hall is not empty"]);
    refuse(here, &["import", "--table", "links.csv"], 2, &["--out"]);
    refuse(here, &["import", "--table", "none.csv", "--out", "bad"], 2, &["no such file; check the path of the table"]);
    for wrong in [&["--table", "a", "--spectra", "b"][..], &["--tx", "a"], &["--table", "links.csv", "--unit", "dB"]] {
        assert_eq!(call(here, &[&["import", "--out", "bad"][..], wrong].concat()).status.code(), Some(2));
    }
}

/// The results of a drive test in degrees are degrees.
#[test]
fn results_of_degrees_are_degrees() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    walk(&here.join("drive.csv"), "lat,lon,cell,rsrp\n", 120, |k, x, y| {
        let cell = k % 2;
        format!("{},{},c{cell},{}", 48.1 + y * 1e-5, 11.5 + x * 1e-5, dbm(x, y, 3.0 * cell as f64, 2.0) - 30.0)
    });
    succeed(here, &["import", "--table", "drive.csv", "--out", "drive"]);
    succeed(here, &["init", "drive", "--out", "drive.ron"]);
    let said =
        stderr(&succeed(here, &["run", "drive.ron", "--scale", "0.01", "--set", "split=Random()", "--out", "run"]));
    assert!(said.contains("the positions of 2 of 2 receivers are unknown"), "{said}");
    write(&here.join("there.csv"), "longitude,latitude\n11.50003,48.10004\n");
    succeed(here, &["predict", "run", "--tx-csv", "there.csv", "--out", "predicted"]);
    let table = fs::read_to_string(here.join("predicted/predictions.csv")).unwrap();
    let mut lines = table.lines();
    assert!(lines.next().unwrap().ends_with(",training_distance_m,latitude,longitude"), "{table}");
    assert!(lines.next().unwrap().ends_with(",48.1000400,11.5000300"), "{table}");
    succeed(here, &["map", "run", "--plane", "z=0", "--step", "0.1", "--out", "map"]);
    let table = fs::read_to_string(here.join("map/map.csv")).unwrap();
    assert!(table.lines().next().unwrap().ends_with("first_latitude,first_longitude,last_latitude,last_longitude"));
    let bounds = |bounds: &str, out: &str| {
        let said = stderr(&succeed(here, &["map", "run", "--plane", "z=0", "--bounds", bounds, "--out", out]));
        (said, fs::read_to_string(here.join(out).join("map.csv")).unwrap())
    };
    // A hundredth of a degree is 1,112 m, or 743 m along a circle of latitude.
    let (said, table) = bounds("48.1,48.11,11.5,11.51", "degrees");
    assert!(said.contains("grid spacing 2 m, chosen for the size of the map; set --step to change this"), "{said}");
    let cells: Vec<&str> = table.lines().nth(1).unwrap().split(',').collect();
    assert_eq!((cells[7], cells[10], cells[11], cells[17]), ("373", "556", "2", "48.1000000"), "{table}");
    assert!(bounds("-2500,2500,-2500,2500", "wide").0.contains("grid spacing 20 m"));
    succeed(here, &["locate", "run", "--out", "located"]);
    let table = fs::read_to_string(here.join("located/locations.csv")).unwrap();
    let last: Vec<f64> = table.lines().nth(1).unwrap().rsplit(',').take(2).map(|cell| cell.parse().unwrap()).collect();
    assert!((last[0] - 11.5).abs() < 0.001 && (last[1] - 48.1).abs() < 0.001, "{table}");
}

/// Sixty links of 20 transmitters on a grid at 3 receivers: path loss of 22 dB per decade, noise of 1.5 dB.
const LINKS: &str = include_str!("tables/links.csv");

/// Imports a table and returns the scores of `inspect` on a random split: mean of the receiver, log-distance, 5-NN, Kriging.
fn scores(here: &Path, text: &str, options: &[&str]) -> Vec<String> {
    write(&here.join("links.csv"), text);
    succeed(here, &[&["import", "--table", "links.csv", "--out", "links"], options].concat());
    let shown = stdout(&succeed(here, &["inspect", "links"]));
    fs::remove_dir_all(here.join("links")).unwrap();
    let line = shown.lines().find(|line| line.starts_with("Random()")).unwrap();
    line.split_whitespace().skip(5).map(str::to_owned).collect()
}

/// Dialects, codes, degrees and repeated readings of one table: scores of an independent program to four digits. Its Kriging,
/// fitted per receiver, has 0.7241 and 0.8529; this fit of all receivers has 0.7242 and 0.8341.
#[test]
fn scores_do_not_depend_on_the_dialect() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let clean = ["3.906", "0.7063", "1.934", "0.7242", "n/a"];
    let dialects = [
        LINKS.to_owned(),
        LINKS.replace(',', ";").replace('.', ","),
        format!("# survey of floor 2\n# 2024-05-01\n{LINKS}"),
        format!("WigleWifi-1.4,appRelease=1,model=x\n{LINKS}"),
        LINKS.replacen("b,8,", "b,8.000000000001,", 1),
    ];
    for text in dialects {
        assert_eq!(scores(here, &text, &[]), clean);
    }
    // Rows in which nothing was heard, and what they hold.
    let silent = [2, 6, 10, 17, 25, 32, 36, 39, 40, 42, 56, 60];
    for code in ["100", "-200", "0", "NaN", ""] {
        let line = |(k, line): (usize, &str)| {
            let (head, _) = line.rsplit_once(',').unwrap();
            if silent.contains(&(k + 1)) { format!("{head},{code}\n") } else { format!("{line}\n") }
        };
        let text: String = LINKS.lines().enumerate().map(line).collect();
        let options = ["--missing", code];
        let is_number = code.parse::<f64>().is_ok_and(f64::is_finite);
        if is_number {
            write(&here.join("links.csv"), &text);
            let words = [&*format!("12 are {code}, "), &*format!("`--missing {code}`"), "--accept lone-value"];
            refuse(here, &["import", "--table", "links.csv", "--out", "bad"], 2, &words);
        }
        assert_eq!(scores(here, &text, if is_number { &options } else { &[] })[3], "0.8341", "{code}");
    }
    // Units, and what the refusal advises.
    for (unit, convert) in [("W", (|v| 10_f64.powf(v / 10.0 - 3.0)) as fn(f64) -> f64), ("positive-dBm", |v| -v)] {
        let line = |line: &str| {
            let (head, dbm) = line.rsplit_once(',').unwrap();
            dbm.parse().map_or_else(|_| format!("{line}\n"), |dbm: f64| format!("{head},{:?}\n", convert(dbm)))
        };
        let text: String = LINKS.lines().map(line).collect();
        write(&here.join("links.csv"), &text);
        refuse(here, &["import", "--table", "links.csv", "--out", "bad"], 2, &[&format!("`--unit {unit}`")]);
        assert_eq!(scores(here, &text, &["--unit", unit]), clean);
    }
    // Each link twice, 1 dB apart: 0.5 dB is the noise of both readings about their mean.
    let again: String = LINKS.lines().skip(1).fold(String::new(), |text, line| {
        let (head, dbm) = line.rsplit_once(',').unwrap();
        text + &format!("{head},{:.1}\n", dbm.parse::<f64>().unwrap() + 1.0)
    });
    let twice = scores(here, &format!("{LINKS}{again}"), &[]);
    assert_eq!(twice[4], "0.7071", "1 dB between two readings is a standard deviation of 0.7071 dB each");
    // Latitude and longitude as x and y.
    let degrees = |line: &str| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        for (k, zero, metres) in
            [(0, 48.137, 111_195.0), (1, 11.575, 74_210.0), (4, 48.137, 111_195.0), (5, 11.575, 74_210.0)]
        {
            cells[k] = cells[k].parse().map_or(cells[k].clone(), |v: f64| format!("{:.7}", zero + v / metres));
        }
        cells.join(",") + "\n"
    };
    let text: String = LINKS.lines().map(degrees).collect();
    write(&here.join("links.csv"), &text);
    refuse(here, &["import", "--table", "links.csv", "--out", "bad"], 2, &["look like degrees; add --lat-lon"]);
    let found: Vec<f64> = scores(here, &text, &["--lat-lon"])[..4].iter().map(|score| score.parse().unwrap()).collect();
    for (found, expected) in found.iter().zip(clean) {
        assert!((found - expected.parse::<f64>().unwrap()).abs() < 0.05, "{found} {expected}");
    }
}
