//! Data with map coordinates: all outputs are in the frame of the user.

use crate::common::{measured, refuse, stderr, stdout, succeed, write};
use pwrfgs::model::file;
use std::path::Path;

/// `measured` with UTM coordinates.
fn on_a_map(here: &Path) {
    measured(here);
    let row = |i: u32| format!("500000.{i},5399999.54,100.5\n");
    write(&here.join("data/tx_pos.csv"), format!("x,y,z\n{}", (1..=6).map(row).collect::<String>()));
    gateway(here, "[500000.25, 5399998.54, 100.0]");
}

fn gateway(here: &Path, position: &str) {
    let text = format!("gateway1: {{position: {position}, orientation: [0.0, 0.0, 0.0, 1.0]}}\nelevation: [-90, 90]\n");
    write(&here.join("data/gateway_info.yml"), text);
}

#[test]
fn predictions_return_positions_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    on_a_map(here);
    succeed(here, &["run", "p.ron", "--out", "r", "-q"]);
    let text = |name: &str| std::fs::read_to_string(here.join(name)).unwrap();
    assert!(text("r/samples.csv").contains("\n2,500000.2,5399999.54,100.5,train,"), "{}", text("r/samples.csv"));
    let nearest = text("r/samples.csv").lines().nth(5).unwrap().rsplit(',').next().unwrap().parse::<f64>().unwrap();
    assert!((nearest - 0.1).abs() < 1e-6, "centimetres survive: {nearest}");
    let model = file::read(&here.join("r/model.safetensors")).unwrap();
    assert_eq!(model.stages.origin.0, [500_000.0, 5_399_999.0, 100.0]);
    assert_eq!(model.stages.world_pose().position, [500_000.25, 5_399_998.54, 100.0]);
    let report = text("r/report.html");
    for words in ["x − 500000 [m]", "y − 5399999 [m]", "z − 100 [m]", "5399998.5"] {
        assert!(report.contains(words), "{words} on the axes or in the bounds");
    }

    let tx = "500000.2,5399999.54,100.5";
    succeed(here, &["predict", "r/model.safetensors", "--tx", tx, "--out", "heard", "-q"]);
    assert!(text("heard/predictions.csv").contains("\n1,500000.2,5399999.54,100.5,"));
    let message = succeed(here, &["evaluate", "r/model.safetensors"]);
    assert!(stdout(&message).contains("ssim") && !stderr(&message).contains("receiver pose"), "{}", stderr(&message));
    let message = succeed(here, &["export", "r/model.safetensors", "--ply", "m.ply", "--npz", "m.npz", "--tx", tx]);
    assert!(stderr(&message).contains("relative to 500000, 5399999, 100"), "{}", stderr(&message));
    let ply = String::from_utf8_lossy(&std::fs::read(here.join("m.ply")).unwrap()).into_owned();
    assert!(ply.contains("\ncomment origin 500000 5399999 100\n"), "{ply}");
    let mut archive = zip::ZipArchive::new(std::fs::File::open(here.join("m.npz")).unwrap()).unwrap();
    let mut array = |name: &str| {
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut archive.by_name(name).unwrap(), &mut bytes).unwrap();
        pwrfgs::core::testing::npy(&bytes).1
    };
    assert_eq!(array("tx.position.npy"), [500_000.2, 5_399_999.54, 100.5]);
    assert_eq!(array("pose.position.npy"), [500_000.25, 5_399_998.54, 100.0]);
    assert_eq!(array("origin.npy"), [500_000.0, 5_399_999.0, 100.0]);
    let world = model.stages.origin.world(model.cloud.means[0]);
    assert_eq!(array("means.npy")[..3], world);
}

#[test]
fn reports_coordinates_out_of_range() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    measured(here);
    let run = ["run", "p.ron", "--out", "r", "-q"];
    gateway(here, "[1e308, 0, 0]");
    refuse(here, &run, 2, &["gateway_info.yml:1:11: the position is 1e308 m, beyond 1e8 m"]);
    measured(here);
    let table = std::fs::read_to_string(here.join("data/tx_pos.csv")).unwrap();
    write(&here.join("data/tx_pos.csv"), table.replace("0.3,1.0", "0.3,-2e8"));
    refuse(here, &run, 2, &["tx_pos.csv:4:5: `-2e8` is beyond 1e8 m"]);
    write(&here.join("data/tx_pos.csv"), table);
    write(&here.join("data/cloud.xyz"), "0 0 0\n0 1e30 0\n");
    let data = "data=Nerf2Spectrum(root: \"data\", points: \"data/cloud.xyz\")";
    refuse(here, &[&run[..], &["--set", data]].concat(), 2, &["cloud.xyz:2:3: `1e30` is beyond 1e8 m"]);
    succeed(here, &run);
    let predict = ["predict", "r/model.safetensors", "--out", "p", "--tx"];
    refuse(here, &[&predict[..], &["0,1e9,0"]].concat(), 2, &["at most 1e8"]);
}
