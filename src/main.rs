//! The `planagent` program; everything lives in the library.

use mimalloc::MiMalloc;

/// Tensors of a pass come and go by megabytes, and glibc gives each back to the system: page faults would take a good part
/// of the time of a long prompt.
#[global_allocator]
static ALLOCATOR: MiMalloc = MiMalloc;

fn main() -> std::process::ExitCode {
    planagent::cli::run()
}
