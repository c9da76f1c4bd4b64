//! The folder that cases are tried in: one small file of every format, most of them made by the library itself.

use pwrfgs::experiment::sweep::{ListedRun, Listing};
use pwrfgs::experiment::{load, read_pipeline};
use pwrfgs::model::file;
use pwrfgs::prelude::*;
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

const PIPELINE: &str = r#"Pipeline(
    name: "small", seed: 1, tensorboard: true,
    data: Teacher(gaussians: 3, samples: 10, width: 12, height: 6),
    split: Official(validation: 0.3),
    initializer: Grid(count: 6, distance_m: 3.0),
    deformation: Mlp(depth: 2, width: 8, skip: None, tx_hidden: 8, tx_features: 4, position_frequencies: 2),
    pruners: [LearnableMask(lambda: 0.02, learning_rate: 0.1), OpacityThreshold(epsilon: 0.01), TopK(keep: 4)],
    baselines: [MeanSpectrum(), NearestNeighbours(k: 1)],
    metrics: [Ssim(), RateRatio(snr_db: 0.0), GaussianCount(), Chamfer()],
    training: (
        steps: 4, batch: 2, stride: 1, densify_until: 2, prune_until: 3, prune_every: 1, validate_every: 2,
        checkpoint_every: 2, densify: (every: 1, from: 1, max_gaussians: 9), loss: (ssim_weight: 0.2),
        optimizer: (means: LogLinear(first: 1e-3, last: 1e-5, steps: 4), quats: Constant(0.001)),
    ),
)
"#;
const EXPERIMENT: &str = r#"Experiment(
    name: "sweep", base: "p.ron", seeds: [0, 1], set: (training: (batch: 1)),
    axes: [
        Axis(name: "steps", variants: [(label: "short", training: (steps: 4)), (label: "long", training: (steps: 5))]),
        Axis(name: "start", variants: [(label: "3", initializer: Grid(count: 3)), (label: "b", pruners: [])]),
    ],
    slurm: (cpus: 4, memory: "8G", time: "02:00:00", options: ["--qos=long"]),
)
"#;
const SCENE: &str = r#"(
    name: "closet", about: "tiny", carrier_hz: 3.5e9,
    room: (
        outline: Plan(corners: [(0, 0), (4, 0), (4, 3), (0, 3)], ceiling: 2.5),
        walls: (material: "brick", thickness_m: 0.15), floor: (material: "own", thickness_m: 0.2),
        ceiling: (material: "ceiling_board", thickness_m: 0.02),
    ),
    materials: { "own": (a: 4.1, c: 0.03, d: 0.8, range_ghz: (1, 100)) },
    objects: [
        Mesh(name: "table", file: "cloud/mesh.obj", scale: 0.5, shift: (1.2, 0.9, 0.5), finish: (material: "wood", thickness_m: 0.02)),
        Panel(name: "screen", from: (2.9, 0.5), to: (2.9, 2.0), heights: (0.5, 1.5), finish: (material: "metal", thickness_m: 0.01)),
        Box(name: "box", low: (0.5, 2.4, 0), high: (1.0, 2.9, 0.8), yaw_deg: 3, finish: (material: "wood")),
    ],
    receiver: (position: (0.3, 1.5, 2), orientation: Facing(direction: (1, 0, -0.25)), array: (rows: 2, columns: 2, element: Patch(exponent: 1))),
    transmitter: (positions: Uniform(low: (1.2, 1.2, 0.9), high: (2.4, 1.8, 1.5))),
    propagation: (order: 1, room_order: 1, roughness: 0.2, lobe: Directive(exponent: 4), patch_m: 0.5),
    noise: (snr_db: 30, phase_error_deg: 2),
)
"#;
const GATEWAY: &str = "dataset_name: small\ngateway1:\n  position: [5.0, 0.26, 0]\n  \
                       orientation: [0.51291602, -0.48674136, -0.48674136, 0.51291602] # x, y, z, w\n";
const XYZ: &str = "# x y z r g b\n0.5 1.5 2.5 255 0 1\n-1e0 .25 3 1 2 3\n2 1 -.5 0 0 0\n1 1 1 9 9 9\n";
const PLY: &str = "ply\nformat ascii 1.0\ncomment small\nelement vertex 4\nproperty float x\nproperty double y\nproperty float z\n\
                   property uchar red\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n0 0 0 1\n1 0 0 2\n\
                   0 1 0 3\n0 0 1 255\n3 0 1 2\n4 0 1 2 3\n";
const OBJ: &str =
    "# a pyramid\no a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvn 0 0 1\nf 1 2 3\nf 1/1 2/1/1 -1//1\nf 1 2 3 4\n";
const STL: &str = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 .1 0\nendloop\nendfacet\n\
                   endsolid a\n";
/// Other models than that of the pipeline.
const MODELS: [&[&str]; 5] = [
    &["deformation=Fixed()", "readout=Real", "calibration=AsReleased", "projector=WrfgsCompat()"],
    &["deformation=Factored(depth: 2, width: 8, position_encoding: Waves(count: 3, reach: 4.0, seed: 0))"],
    &["deformation=Wrfgs(depth: 2, width: 8, frequencies: 2, skip: None)", "readout=Power"],
    &["rasterizer=ArrayResponse(rows: 2, columns: 2)", "readout=Magnitude"],
    &["readout=MinMax", "initializer=Random(count: 5, std: 1.0)"],
];

/// Makes the folder.
pub fn make(folder: &Path) -> Result<()> {
    let put = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        let above = path.parent().unwrap_or(folder);
        fs::create_dir_all(above).and_then(|()| fs::write(&path, bytes)).map_err(|e| Error::write(&path, e))
    };
    put("p.ron", PIPELINE.as_bytes())?;
    put("e.ron", EXPERIMENT.as_bytes())?;
    put("scene.ron", SCENE.as_bytes())?;
    put("data/gateway_info.yml", GATEWAY.as_bytes())?;
    put("data/tx_pos.csv", b"x,y,\"z\"\n0.1,1.0,0.5\n0.2,1.0,0.5\n\"0.3\",1.0,0.5\n-0.4,1e0,0.5\n0.5,1.0,0.5\n")?;
    put("data/train_index.txt", b"00001\n00002\n3\r\n")?;
    put("data/test_index.txt", b"00004\n00005\n")?;
    put("data/manifest.json", br#"{"simulated": true, "scene": "(name: \"a\")", "samples": 5}"#)?;
    put("positions.csv", b"x,y,z,note\n1.0,2.0,0.5,a\n\"-1\",2e0,.5,\"b,c\"\n0.3,0.1,0.2,d\n")?;
    put("cloud/points.xyz", XYZ.as_bytes())?;
    put("cloud/points.csv", b"x,y,z,label\n0.1,1.0,0.5,wall\n0.2,1.0,0.5,floor\n0.3,1.0,1.5,wall\n")?;
    put("cloud/mesh.ply", PLY.as_bytes())?;
    put("cloud/mesh.obj", OBJ.as_bytes())?;
    put("cloud/mesh.stl", STL.as_bytes())?;
    put("cloud/binary/mesh.stl", &[vec![b' '; 80], vec![2, 0, 0, 0], vec![0; 36], vec![63; 64]].concat())?;
    let (head, _) = PLY.split_once("0 0 0 1").unwrap_or_default();
    let binary = head.replace("ascii", "binary_little_endian").replace("double", "float");
    let rows = [[0_u8; 13], [63; 13], [64; 13], [1; 13]].concat();
    let faces = [&[3, 0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0][..], &[3, 1, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0]].concat();
    put("cloud/binary/mesh.ply", &[binary.as_bytes(), &rows, &faces].concat())?;
    shipped(&put)?;
    fs::create_dir_all(folder.join("data/spectrum")).map_err(|e| Error::write(folder, e))?;
    for id in 1..=5 {
        let path = folder.join(format!("data/spectrum/{id:05}.png"));
        let picture = image::GrayImage::from_fn(12, 6, |x, y| image::Luma([(7 * x + 11 * y * id) as u8]));
        picture.save(&path).map_err(|e| Error::input(&path, e))?;
    }
    runs(folder)?;
    models(folder)
}

/// The files of the repository that a user begins with.
fn shipped(put: &dyn Fn(&str, &[u8]) -> Result<()>) -> Result<()> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    for below in ["pipelines", "experiments", "scenes", "scenes/meshes"] {
        for entry in fs::read_dir(root.join(below)).map_err(|e| Error::read(&root, e))?.flatten() {
            if let Ok(bytes) = fs::read(entry.path()) {
                put(&format!("{below}/{}", entry.file_name().to_string_lossy()), &bytes)?;
            }
        }
    }
    Ok(())
}

/// A sweep folder with one finished run, and a run that was stopped half-way.
fn runs(folder: &Path) -> Result<()> {
    let pipeline = read_pipeline(&folder.join("p.ron"), &[])?;
    pwrfgs::run(&pipeline, folder, &folder.join("sweep/a"), &mut Silent, &AtomicBool::new(false))?;
    let run = ListedRun { folder: "a".into(), labels: vec![("steps".into(), "4".into())], seed: 1 };
    Listing { name: "sweep".into(), runs: vec![run] }.write(&folder.join("sweep"))?;
    let stop = AtomicBool::new(false);
    pwrfgs::run(&pipeline, folder, &folder.join("half"), &mut Stopper(&stop), &stop)?;
    Ok(())
}

/// Stops a run after its third step: pruned, and a look at the validation part behind it.
struct Stopper<'a>(&'a AtomicBool);

impl Observer for Stopper<'_> {
    fn on_step(&mut self, report: &StepReport) {
        self.0.store(report.step >= 3, Ordering::Relaxed);
    }
}

/// Untrained models of every kind.
fn models(folder: &Path) -> Result<()> {
    let put = |name: &str, model: &Model| file::write(&folder.join("models").join(name), model);
    fs::create_dir_all(folder.join("models")).map_err(|e| Error::write(folder, e))?;
    for (i, settings) in MODELS.iter().enumerate() {
        let mut pipeline = read_pipeline(&folder.join("p.ron"), &[])?;
        settings.iter().try_for_each(|setting| pipeline.set(setting))?;
        let (data, partition) = load(&pipeline, folder, &mut Silent)?;
        put(&format!("{i}.safetensors"), &Trainer::new(&pipeline, &data, &partition)?.model())?;
    }
    let trained = file::read(&folder.join("sweep/a/model.safetensors"))?;
    let half = folder.join("models/half.safetensors");
    fs::write(&half, file::to_bytes_half(&trained)?).map_err(|e| Error::write(&half, e))?;
    put("model.safetensors", &trained)
}
