//! The `planagent` program; everything lives in the crate of the command line.

use mimalloc::MiMalloc;
use planagent_cli::MAX_THREADS;

/// Tensors of a pass come and go by megabytes, and glibc gives each back to the system: page faults
/// would take a good part of the time of a long prompt.
#[global_allocator]
static ALLOCATOR: MiMalloc = MiMalloc;

fn main() -> std::process::ExitCode {
    name_threads();
    planagent_cli::run(option_env!("PLANAGENT_COMMIT"))
}

/// candle asks for its number of threads at each product. Without this variable it reads
/// `/proc/cpuinfo` each time, which took a seventh of the CPU time of a simulation with nano.
#[allow(unsafe_code)]
fn name_threads() {
    const THREADS: &str = "RAYON_NUM_THREADS";
    if std::env::var_os(THREADS).is_none()
        && let Ok(threads) = std::thread::available_parallelism()
    {
        // SAFETY: `main` calls this first, so no other thread can read the environment meanwhile.
        unsafe { std::env::set_var(THREADS, threads.get().min(MAX_THREADS).to_string()) }
    }
}
