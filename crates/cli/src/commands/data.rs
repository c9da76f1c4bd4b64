//! `pwrfgs data`: lists public data sets, and checks a downloaded one. The program downloads nothing.

use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::{Args, Subcommand};
use pwrfgs::experiment::text::{align_columns, grouped};
use pwrfgs::experiment::{check_findings, describe_observations, run_stage};
use pwrfgs::tasks::init::unknown_folder_error;
use pwrfgs_core::files::{digest, if_found, read};
use pwrfgs_core::plugin::name_of;
use pwrfgs_core::{Dataset, Result, recognise};
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
#[command(after_help = "\
Without a subcommand, the command prints licence, citation, size, address and folder of public data
sets. It downloads nothing: each entry has a command or the steps for the download.
`pwrfgs data check` describes a folder and compares up to three of its files with the copy behind
the scores in docs/results.md. It lists files that differ or are missing. The exit code is 0 even
then, because your copy may be newer.

EXAMPLES
  pwrfgs data
  pwrfgs data check data/s23")]
pub(crate) struct Data {
    #[command(subcommand)]
    pub(crate) action: Option<DataAction>,
}

#[derive(Debug, Subcommand)]
pub(crate) enum DataAction {
    /// Check layout, content and SHA-256 digests of a data folder
    Check {
        /// Data folder
        #[arg(value_name = "FOLDER")]
        folder: PathBuf,
    },
}

/// Public data set.
struct PublicData {
    name: &'static str,
    content: &'static str,
    licence: &'static str,
    size: &'static str,
    source: &'static str,
    /// Download, as a command or in words.
    download: &'static str,
    /// Folder in which the shipped pipelines expect it.
    folder: &'static str,
    pipelines: &'static str,
    /// SHA-256 of files of the copy behind the scores in `docs/results.md`.
    digests: &'static [(&'static str, &'static str)],
}

const NERF2: &str = "https://connectpolyu-my.sharepoint.com/:f:/g/personal/20032132r_connect_polyu_hk/EuAACSdRP4VGgw_9n2IqL84BkY_tWD5TeE9kDT0lvjw6jw?e=ygYEvX";
const NERF2_LICENCE: &str = "MIT, data included (https://github.com/XPengZhao/NeRF2); cite Zhao et al., MobiCom 2023";

const PUBLIC: [PublicData; 5] = [
    PublicData {
        name: "s23",
        content: "measured spectra of 6,123 transmitter positions, 920 MHz, 4 x 4 antennas (NeRF2, RFID)",
        licence: NERF2_LICENCE,
        size: "50 MB unpacked",
        source: NERF2,
        download: "open the address in a browser, download RFID/s23-dataset.tar.gz and unpack it (no direct link for curl)",
        folder: "data/s23",
        pipelines: "s23-laptop, s23-array, paper, dense, thinned, nerf2, nerf2-laptop, pwrfgs, wrfgs",
        digests: &[
            ("gateway_info.yml", "e04ec8dba6f4828898c6f4245cfb55283c75e94d46bac33d07382ee5c1dd182a"),
            ("tx_pos.csv", "c7f560952555ae95b05ba3663d0212baaa8c62e80073be32d67098f2e943f885"),
            ("spectrum/00001.png", "56ff1f6e028556357fc70d08c87d51f75905575c90a0c4f176719e80770b0d8d"),
        ],
    },
    PublicData {
        name: "BLE",
        content: "measured received power of 4,800 transmitter positions at 21 gateways (NeRF2, BLE)",
        licence: NERF2_LICENCE,
        size: "0.8 MB unpacked",
        source: NERF2,
        download: "open the address in a browser, download BLE/rssi-dataset-1.tar.gz and unpack it (no direct link for curl)",
        folder: "data/ble",
        pipelines: "ble, nerf2-ble",
        digests: &[
            ("gateway_position.yml", "2de978e259dbf5c165c9924a92cc49146c1204d37c6c0982c92bcd2e56be7b60"),
            ("gateway_rssi.csv", "0b5682be02853a0db536c17f1f232812832451f748c383fffd17379939571243"),
            ("tx_pos.csv", "9e0b296dba5a7e59164f8c080ec785b24e6dfe1b3ecc04f8a3dd0f7f39a9323b"),
        ],
    },
    PublicData {
        name: "NeWRF",
        content: "*simulated* channels of a conference room, 433 MHz to 5.8 GHz, 395 or 433 positions",
        licence: "MIT; cite Lu et al., ICML 2024 (arXiv:2403.03241)",
        size: "72 kB after the conversion in docs/data.md",
        source: "https://github.com/LuHaofan/NeWRF, folder data/",
        download: "curl -LO https://raw.githubusercontent.com/LuHaofan/NeWRF/HEAD/data/dataset_conference_433MHz_rt_image_fc.pkl",
        folder: "data/newrf",
        pipelines: "newrf",
        digests: &[
            ("csi_433MHz.npy", "cd25e96ef53b0d09e5a5e5dd34fc53dfd82566cab3820ae061940c4780530dda"),
            ("csi_433MHz_pos.csv", "186284e29e28d5af3b03cfcc6ef9fad1b0777592a0dc7753ba6dea3532bbb1f6"),
        ],
    },
    PublicData {
        name: "RF-3DGS",
        content: "*simulated* spatial spectra at moving receivers in a lobby (Sionna), camera images",
        licence: "code Apache-2.0; licence of the data not verified; cite Zhang et al. (arXiv:2411.19420)",
        size: "not verified",
        source: "https://github.com/SunLab-UGA/RF-3DGS",
        download: "follow the link to its data in the README (no direct link for curl)",
        folder: "any",
        pipelines: "write one with `pwrfgs init`",
        digests: &[],
    },
    PublicData {
        name: "DeepMIMO",
        content: "*simulated* paths and channels of many sites, by ray tracing",
        licence: "code Apache-2.0; each scenario states its own licence; cite Alkhateeb, ITA 2019",
        size: "differs between scenarios",
        source: "https://www.deepmimo.net",
        download: "pip install deepmimo && python3 -c 'import deepmimo; deepmimo.download(\"asu_campus_3p5\")'",
        folder: "any",
        pipelines: "none: pwrfgs.convert.from_deepmimo, in Python, converts a scenario",
        digests: &[],
    },
];

/// Runs `pwrfgs data`: prints the public data sets, or the description of a folder.
pub(crate) fn print_data(arguments: &Data, verbosity: Verbosity) -> Result<()> {
    let text = match &arguments.action {
        None => list_public_data(),
        Some(DataAction::Check { folder }) => describe_folder(folder, verbosity)?,
    };
    output::print_result(&text)
}

/// Lists the properties of each public data set.
fn list_public_data() -> String {
    let entry = |set: &PublicData| {
        let rows = [
            ("  licence", set.licence),
            ("  size", set.size),
            ("  address", set.source),
            ("  download", set.download),
            ("  copy to", set.folder),
            ("  pipelines", set.pipelines),
        ];
        let rows = rows.map(|(name, value)| vec![name.to_owned(), value.to_owned()]);
        format!("{}: {}\n{}", set.name, set.content, align_columns(&rows, 2))
    };
    PUBLIC.each_ref().map(entry).join("\n")
        + "\nFormats and splits: docs/data.md. Check a downloaded folder: pwrfgs data check FOLDER\n"
}

/// Describes layout, observations and split of a folder, and compares its digests with those of public data. A folder
/// of unknown layout is an error, unless it has a file of public data.
fn describe_folder(folder: &Path, verbosity: Verbosity) -> Result<String> {
    if !folder.is_dir() {
        return Err(unknown_folder_error(folder));
    }
    let digests = compare_digests(folder)?;
    let Some(source) = recognise(folder) else {
        return digests.ok_or_else(|| unknown_folder_error(folder));
    };
    let data = RunProgress::observe(verbosity, |progress| {
        let data = run_stage(progress, "observations", |bar| source.load(Path::new(""), bar))?;
        check_findings(&data, None, None, progress)?;
        Ok(data)
    })?;
    let none = || "digests: no file of a known public data set; `pwrfgs data` lists them\n".to_owned();
    let origin = if data.is_simulated() { "simulated" } else { "measured" };
    let layout = format!("layout: {}, {}, {origin}\n", name_of(&source), describe_observations(&data));
    Ok(layout + &describe_official_split(&data) + &digests.unwrap_or_else(none))
}

/// Describes the sizes of the split in the index files of the data.
fn describe_official_split(data: &Dataset) -> String {
    match &data.official {
        Some((train, test)) => {
            format!("index files: {} training, {} test\n", grouped(train.len() as i64), grouped(test.len() as i64))
        }
        None => "index files: none\n".into(),
    }
}

/// Compares the files of a folder with those of the first public data set that has an equal file; `None` without such a
/// data set.
fn compare_digests(folder: &Path) -> Result<Option<String>> {
    for set in &PUBLIC {
        let mut rows = Vec::new();
        let mut equal = 0;
        for (name, expected) in set.digests {
            let path = folder.join(name);
            let state = match if_found(&path, read(&path))?.map(|bytes| digest(&bytes)) {
                Some(actual) if actual == *expected => {
                    equal += 1;
                    "equal".to_owned()
                }
                Some(actual) => format!("differs: {actual}"),
                None => "missing".into(),
            };
            rows.push(vec![format!("  {name}"), state]);
        }
        if equal == 0 {
            continue;
        }
        let head =
            format!("digests: {equal} of {} files equal the {} files behind docs/results.md\n", rows.len(), set.name);
        return Ok(Some(head + &align_columns(&rows, 2)));
    }
    Ok(None)
}
