//! The program `pwrfgs`. A program with further plugins is `use my_plugin as _;` and these lines.

use std::process::ExitCode;

fn main() -> ExitCode {
    pwrfgs_cli::main()
}
