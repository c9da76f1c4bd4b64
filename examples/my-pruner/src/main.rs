use my_pruner as _; // links the crate; without this line, its plugins are unknown

fn main() -> std::process::ExitCode {
    pwrfgs_cli::main()
}
