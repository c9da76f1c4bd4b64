//! The program `pwrfgs`. One with plugins of its own is `use my_plugin as _;` and these lines.

use std::process::ExitCode;

fn main() -> ExitCode {
    pwrfgs_cli::main()
}
