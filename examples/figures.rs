//! Draws the figures of a comparison of runs: `cargo run -p pwrfgs --example figures -- OUT RUN..`. Each `RUN` is a run
//! folder or a sweep folder.
#![allow(clippy::print_stdout)] // example program

use pwrfgs::report::{Study, figures};
use std::path::PathBuf;

fn main() -> pwrfgs::core::Result<()> {
    let mut folders = std::env::args_os().skip(1).map(PathBuf::from);
    let out = folders.next().unwrap_or_else(|| "figures".into());
    let study = Study::read(&folders.collect::<Vec<_>>())?;
    for (k, setting) in study.settings.iter().enumerate() {
        let folder = out.join(format!("setting-{}", k + 1));
        let drawn = figures::draw_figures(setting, &[], &[], &|_, _| {});
        for figure in drawn.figures {
            figure.write(&folder)?;
            println!("{}/{}: {}", folder.display(), figure.name, figure.caption);
        }
        drawn.left_out.iter().for_each(|why| println!("{}: {why}", folder.display()));
    }
    Ok(())
}
