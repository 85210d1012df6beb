//! The `planagent` program; everything lives in the crate of the command line.

use mimalloc::MiMalloc;
use planagent_cli::MAX_THREADS;
use std::ffi::{c_int, c_long};

/// Tensors of a pass come and go by megabytes, and glibc gives each back to the system: page faults
/// would take a good part of the time of a long prompt.
#[global_allocator]
static ALLOCATOR: MiMalloc = MiMalloc;

fn main() -> std::process::ExitCode {
    name_threads();
    keep_memory();
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

/// By default, mimalloc gives memory back that was free for a second. The next picture takes it
/// again, page by page, which was a tenth of the time of encoding it.
#[allow(unsafe_code)]
fn keep_memory() {
    /// `mi_option_purge_delay` of `mimalloc.h`; -1 is never.
    const PURGE_DELAY: c_int = 15;
    unsafe extern "C" {
        /// Sets an option of the allocator.
        fn mi_option_set(option: c_int, value: c_long);
    }
    // SAFETY: the function is part of the allocator above. It sets a number, which is read when
    // memory is freed.
    unsafe { mi_option_set(PURGE_DELAY, -1) }
}
