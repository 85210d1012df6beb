//! Child processes that end with the program, however it ends.
//!
//! On Unix, a child runs in a process group of its own, beside a guard: a shell that waits for the
//! end of a pipe whose other end only this program holds. The system closes that end when the
//! program ends, even by SIGKILL. The guard then kills the group. A process that leaves its group,
//! for example by `setsid`, is not reached. On other systems, only the drop of a [`BoundChild`] ends
//! its process.

#[cfg(unix)]
mod living;

#[cfg(unix)]
pub use living::{end_all, wait_if_ending};

use std::io;
use std::process::{Child, Command};

/// Waits for the end of its stdin, then kills its process group, itself included. Signals of a
/// terminal, and those that a command sends to its own group, do not end it before: it writes a line
/// once it ignores them.
#[cfg(unix)]
const GUARD: &str = "trap '' HUP INT QUIT TERM; echo; read -r end; kill -9 0";

/// A running process. It ends, on Unix with all processes of its group, when this is dropped and
/// when the program ends.
#[derive(Debug)]
pub struct BoundChild {
    child: Child,
    #[cfg(unix)]
    guard: Child,
}

impl BoundChild {
    /// Starts a command.
    ///
    /// # Errors
    /// When it cannot be started, or, on Unix, `sh` cannot.
    pub fn spawn(command: &mut Command) -> io::Result<Self> {
        #[cfg(unix)]
        {
            use std::os::unix::process::CommandExt;
            // Nothing begins while the program ends.
            let mut living = living::lock();
            let mut guard = guard()?;
            // The guard leads the group, so that the group exists as long as the guard is not
            // waited for, and its number goes to no other.
            let group = i32::try_from(guard.id()).map_err(io::Error::other);
            match group.and_then(|group| command.process_group(group).spawn()) {
                Ok(child) => {
                    living.push(living::Group::new(&guard, &child));
                    Ok(Self { child, guard })
                }
                Err(error) => {
                    // It holds nothing yet, and the error of the command is the one to tell.
                    let _ = guard.kill();
                    let _ = guard.wait();
                    Err(error)
                }
            }
        }
        #[cfg(not(unix))]
        Ok(Self {
            child: command.spawn()?,
        })
    }

    /// The process: its pipes, its status, its number.
    pub fn process(&mut self) -> &mut Child {
        &mut self.child
    }

    /// The number of the process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }
}

/// Starts the guard and waits until it ignores signals: a command may signal its group at once.
#[cfg(unix)]
fn guard() -> io::Result<Child> {
    use std::io::Read;
    use std::os::unix::process::CommandExt;
    use std::process::Stdio;
    let mut guard = Command::new("sh")
        .args(["-c", GUARD])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .process_group(0)
        .spawn()
        .map_err(|error| no_guard(&error))?;
    let ready = match guard.stdout.take() {
        Some(mut stdout) => stdout.read_exact(&mut [0]),
        None => Err(io::ErrorKind::BrokenPipe.into()),
    };
    if let Err(error) = ready {
        let _ = guard.kill();
        let _ = guard.wait();
        return Err(no_guard(&error));
    }
    Ok(guard)
}

#[cfg(unix)]
fn no_guard(error: &io::Error) -> io::Error {
    io::Error::other(format!(
        "sh, which ends a command with this program, cannot be started: {error}"
    ))
}

/// On this system, a program that ends leaves its children.
#[cfg(not(unix))]
pub fn end_all() {}

/// On this system, no child ends before its program.
#[cfg(not(unix))]
pub fn wait_if_ending() {}

impl Drop for BoundChild {
    fn drop(&mut self) {
        // Held until both are waited for: their numbers may then go to others.
        #[cfg(unix)]
        let mut living = living::lock();
        #[cfg(unix)]
        {
            let group = living::Group::new(&self.guard, &self.child);
            group.kill();
            living.retain(|other| *other != group);
        }
        // On Unix, a process that left the group is still ours to end.
        let _ = self.child.kill();
        // Takes the exit status, so that no zombie stays.
        let _ = self.child.wait();
        #[cfg(unix)]
        let _ = self.guard.wait();
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::io::Write;
    use std::path::Path;
    use std::process::Stdio;
    use std::thread::sleep;
    use std::time::{Duration, Instant};

    /// Time after which a process that should end counts as running.
    const PATIENCE: Duration = Duration::from_secs(20);

    /// Whether `work` becomes true in time.
    fn soon(mut work: impl FnMut() -> bool) -> bool {
        let began = Instant::now();
        while began.elapsed() < PATIENCE {
            if work() {
                return true;
            }
            sleep(Duration::from_millis(10));
        }
        false
    }

    /// A command that writes its number to a file, with a process in the background that does too.
    fn two_processes(folder: &Path) -> Command {
        let (one, two) = (folder.join("one"), folder.join("two"));
        let script = format!(
            "sh -c 'echo $$ > {}; exec sleep 100' & echo $$ > {}; exec sleep 100",
            two.display(),
            one.display()
        );
        let mut shell = Command::new("sh");
        shell.args(["-c", &script]);
        shell
    }

    /// The numbers of both processes, once they run.
    fn numbers(folder: &Path) -> [String; 2] {
        let mut found = [String::new(), String::new()];
        assert!(soon(|| {
            for (number, name) in found.iter_mut().zip(["one", "two"]) {
                *number = std::fs::read_to_string(folder.join(name)).unwrap_or_default();
            }
            found.iter().all(|number| number.ends_with('\n'))
        }));
        found.map(|number| number.trim().to_owned())
    }

    /// Whether a process runs; a zombie does not.
    fn runs(number: &str) -> bool {
        if Path::new("/proc/self/stat").exists() {
            let stat = std::fs::read_to_string(format!("/proc/{number}/stat")).unwrap_or_default();
            // The state follows the name, which stands in parentheses.
            let state = stat.rsplit_once(") ").map_or("", |(_, rest)| rest);
            return !state.is_empty() && !state.starts_with('Z');
        }
        // The shell's own `kill`: a small system has no program of that name.
        let signal = format!("kill -0 {number} 2>/dev/null");
        Command::new("sh")
            .args(["-c", &signal])
            .status()
            .is_ok_and(|status| status.success())
    }

    #[test]
    fn the_drop_ends_a_process_with_all_that_it_started() {
        let folder = tempfile::tempdir().unwrap();
        let child = BoundChild::spawn(&mut two_processes(folder.path())).unwrap();
        let numbers = numbers(folder.path());
        assert!(numbers.iter().all(|number| runs(number)));
        drop(child);
        assert!(soon(|| numbers.iter().all(|number| !runs(number))));
    }

    /// The end of the program closes the pipe of the guard. Here a program ends whose guard is ours.
    #[test]
    fn the_end_of_the_pipe_ends_the_group() {
        let folder = tempfile::tempdir().unwrap();
        let mut child = BoundChild::spawn(&mut two_processes(folder.path())).unwrap();
        let numbers = numbers(folder.path());
        drop(child.guard.stdin.take());
        assert!(soon(|| numbers.iter().all(|number| !runs(number))));
        assert!(!child.process().wait().unwrap().success());
    }

    /// Many times: the command signals as early as it can, when the guard has just begun.
    #[test]
    fn a_command_that_signals_its_group_keeps_its_guard() {
        for _ in 0..100 {
            let mut shell = Command::new("sh");
            shell
                .args(["-c", "trap '' TERM; kill -TERM 0; read -r line; exit 7"])
                .stdin(Stdio::piped());
            let mut child = BoundChild::spawn(&mut shell).unwrap();
            let mut stdin = child.process().stdin.take().unwrap();
            stdin.write_all(b"x\n").unwrap();
            assert_eq!(child.process().wait().unwrap().code(), Some(7));
            assert_eq!(child.guard.try_wait().unwrap(), None);
        }
    }

    #[test]
    fn nobody_waits_for_the_end_of_a_program_that_goes_on() {
        wait_if_ending();
    }

    #[test]
    fn a_command_that_does_not_exist_is_an_error() {
        let error = BoundChild::spawn(&mut Command::new("/no/such/command")).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
    }
}
