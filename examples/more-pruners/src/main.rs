use more_pruners as _; // links the crate; without this line its names are unknown

fn main() -> std::process::ExitCode {
    pwrfgs_cli::main()
}
