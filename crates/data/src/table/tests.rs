use super::*;
use std::path::Path;

/// Reads `text` as a table called `survey.csv`.
fn read(text: &str, import: TableImport) -> Result<ImportedTable, String> {
    let file = TableFile { path: "survey.csv".into(), bytes: Some(text.as_bytes().to_vec()) };
    TableImport { files: vec![file], title: "hall".into(), ..import }.read().map_err(|e| e.to_string())
}

/// Returns position, receiver and power of each link.
fn links(imported: &ImportedTable) -> Vec<([f64; 3], &str, f64)> {
    let data = &imported.data;
    let link = |i: usize| {
        let sample = data.sample(i);
        let dbm = (data.image(i).pixels[0] as f64 * 1e3).round() / 1e3;
        (sample.position(), &*data.scene.receivers[sample.receiver].name, dbm)
    };
    (0..data.len()).map(link).collect()
}

#[test]
fn all_dialects_of_one_table_give_equal_links() {
    let plain = "x,y,z,receiver,rx_x,rx_y,rx_z,dbm\n0,0,1.2,a,0,0,2.5,-42.9\n0,2,1.2,b,8,0,2.5,-59.2\n";
    let expected = vec![([0.0, 0.0, 1.2], "a", -42.9), ([0.0, 2.0, 1.2], "b", -59.2)];
    let semicolons = plain.replace(',', ";").replace('.', ",");
    let dialects = [
        plain.to_owned(),
        semicolons.clone(),
        plain.replace(',', "\t"),
        plain.replace(',', " "),
        plain.replace('\n', "\r\n"),
        plain.replace('\n', "\r"),
        format!("\u{feff}{plain}"),
        format!("# survey of floor 2\n# 2024-05-01\n{plain}"),
        format!("#{plain}"),
        format!("WigleWifi-1.4,appRelease=1,model=x\n{plain}"),
        plain.replace("x,y,z", "\"X [m]\",\"Y (m)\",Height"),
        format!("{plain}4,4,1.2,a,0,0,2.5,NaN\n4,4,1.2,b,8,0,2.5,\n4,2,1.2,b,8,0,2.5,NA\n4,6,1.2,b,8,0,2.5,-\n"),
    ];
    for text in dialects {
        let imported = read(&text, TableImport::default()).unwrap_or_else(|e| panic!("{text}: {e}"));
        assert_eq!(links(&imported), expected, "{text}");
        let receiver = &imported.data.scene.receivers[1];
        assert_eq!((receiver.pose.position, receiver.is_estimated), ([8.0, 0.0, 2.5], false), "{text}");
    }
}
