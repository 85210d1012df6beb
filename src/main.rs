//! The `planagent` program; everything lives in the library.

fn main() -> std::process::ExitCode {
    planagent::cli::run()
}
