//! `pwrfgs view`: a page of predictions for a transmitter that the user moves.

use crate::interrupt::stop_flag;
use crate::output::{self, Verbosity};
use crate::progress::RunProgress;
use clap::Args;
use pwrfgs::experiment::{model_file, with_run};
use pwrfgs::report::room_page;
use pwrfgs::viewer::{PageHost, ViewPane, view as show};
use pwrfgs_core::files::{check_new_file, create};
use pwrfgs_core::{Error, Result, ShippedModel};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

#[derive(Debug, Args)]
#[command(after_help = "\
The command prints the address of a page and serves the page until it is closed or you press Ctrl-C.
Only this machine can open the page, and only with this address, which has a random token.

ON THE PAGE
  transmitter  drag it (with Shift: change its height), or click a measured position; arrow keys
               move it by 10 cm, Page Up and Page Down change its height
  room         drag to rotate, scroll to zoom
  slider       selects a stored snapshot of the training of a run: at the start, before pruning,
               after prune steps, or at the end; new snapshots of a run in progress appear
  locate       for runs with data, shows the estimate of `pwrfgs locate` for the selected sample,
               with a region calibrated to contain nine of ten validation samples
Two models, or a model and a baseline, predict for the same transmitter position. Write the baseline
as in a pipeline, such as 'NearestNeighbours(k: 5)', or give its name.
Models in the program need no data: s23, ble, office-channel (`pwrfgs pipelines` describes them).
--save writes a page that needs no server. In this page, a model of spectra at one fixed receiver
predicts if it is a single model without Kriged residuals (`residuals: Kriged()`) and with the
`deformation` Fixed, Mlp or Factored. Above 1 MiB of Gaussians and network weights, the page has a
compressed model with 8-bit weights, of at most 1.5 MiB. All other pages show stored predictions of
up to 51 test samples.

EXAMPLES
  pwrfgs view s23
  pwrfgs view runs/quickstart
  pwrfgs view runs/quickstart --save room.html
  pwrfgs view runs/quickstart 'NearestNeighbours(k: 5)'
  pwrfgs view runs/s23-best/joined runs/s23-laptop")]
pub(crate) struct View {
    /// Run folder, model file or name of a model in `pwrfgs pipelines` (s23); to compare, another one or a baseline
    /// (Kriging)
    #[arg(value_name = "MODEL_OR_RUN", required = true, num_args = 1..=2)]
    pub(crate) sides: Vec<String>,
    /// Open the page in a browser; other users of this machine may then read the secret address of the page in the
    /// process list
    #[arg(long)]
    pub(crate) open: bool,
    /// Write a page of one finished run that works without a server
    #[arg(long, value_name = "FILE", conflicts_with = "open")]
    pub(crate) save: Option<PathBuf>,
}

/// Runs `pwrfgs view`: serves the page until it is closed, or writes it to the file of `--save`.
pub(crate) fn view(arguments: &View, verbosity: Verbosity) -> Result<()> {
    if let Some(file) = &arguments.save {
        return save_page(&arguments.sides, file, verbosity);
    }
    let panes = RunProgress::observe(verbosity, |progress| open_panes(&arguments.sides, progress))?;
    let stop = stop_flag();
    let ready = |address: &str| {
        // Only the address on stdout, for pipes.
        _ = output::print_result(&format!("{address}\n"));
        verbosity.print_note("open this address in a browser; stop with Ctrl-C or by closing the page");
        if arguments.open && !open_browser(address) {
            output::print_note("cannot start a browser; open the address yourself");
        }
    };
    show(panes, PageHost::Browser, ready, &stop)
}

/// Writes the room of a finished run as a page; `sides` must be this run alone.
fn save_page(sides: &[String], file: &Path, verbosity: Verbosity) -> Result<()> {
    let [run] = sides else { return Err(Error::Config("--save writes one run; name one run folder".into())) };
    if Path::new(run).is_file() || ShippedModel::find(Path::new(run)).is_some() {
        return Err(Error::input(Path::new(run), "model file, expected a run folder for --save"));
    }
    model_file(Path::new(run))?; // a clear error for the folder of a sweep
    check_new_file(file)?;
    let (page, predicts) = RunProgress::observe(verbosity, |progress| with_run(Path::new(run), progress, room_page))?;
    create(file, page.as_bytes())?;
    let content =
        if predicts { "the model predicts in the page" } else { "the page contains stored data and does not predict" };
    verbosity.print_note(&format!("{content}: {}", file.display()));
    Ok(())
}

/// Opens one or two sides of the page: runs or models; the second may be a baseline on the data of the first.
fn open_panes(sides: &[String], progress: &mut RunProgress) -> Result<Vec<ViewPane>> {
    let first = ViewPane::open(Path::new(&sides[0]), progress)?;
    let second = sides.get(1).map(|text| first.open_beside(text, progress)).transpose()?;
    Ok(std::iter::once(first).chain(second).collect())
}

/// Opens `address` in the default browser; returns whether that succeeded.
fn open_browser(address: &str) -> bool {
    let program = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let mut browser = Command::new(program);
    browser.arg(address).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    browser.status().is_ok_and(|status| status.success())
}
