//! Turns a panic inside a simulation into the error of that simulation, so that the run continues.

use std::any::Any;
use std::cell::RefCell;
use std::panic::{self, AssertUnwindSafe, PanicHookInfo};
use std::sync::Once;

thread_local! {
    /// Set while guarded work runs on this thread.
    static GUARD: RefCell<Option<Guard>> = const { RefCell::new(None) };
}

/// What the hook records for [`catch_panic`].
enum Guard {
    NoPanic,
    /// File, line and column of the panic.
    PanickedAt(String),
}

/// Runs `work`; a panic becomes an error with its message and, after [`install_hook`], its place.
pub fn catch_panic<T>(work: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    let before = GUARD.replace(Some(Guard::NoPanic));
    let outcome = panic::catch_unwind(AssertUnwindSafe(work));
    let guard = GUARD.replace(before);
    outcome.unwrap_or_else(|payload| {
        let message = message(payload.as_ref());
        Err(match guard {
            Some(Guard::PanickedAt(place)) => format!("panicked at {place}: {message}"),
            _ => format!("panicked: {message}"),
        })
    })
}

/// Puts a panic hook before the present one, once in a process: inside guarded work it records the
/// place of a panic and prints nothing. Only a hook knows the place. It is process-wide, so the
/// program installs it and the library does not.
pub fn install_hook() {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let other = panic::take_hook();
        panic::set_hook(Box::new(move |info: &PanicHookInfo<'_>| {
            let guarded = GUARD.with_borrow_mut(|guard| {
                let guarded = guard.is_some();
                if guarded {
                    *guard = Some(Guard::PanickedAt(
                        info.location()
                            .map_or_else(String::new, ToString::to_string),
                    ));
                }
                guarded
            });
            if !guarded {
                other(info);
            }
        }));
    });
}

fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().copied();
    text.or_else(|| payload.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no message")
        .to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_an_error_with_message_and_place() {
        install_hook();
        let outcome: Result<(), String> =
            catch_panic(|| panic!("the wheel came off after {} m", 3));
        let error = outcome.unwrap_err();
        assert!(
            error.contains("panic_guard.rs") && error.contains("the wheel came off after 3 m"),
            "{error}"
        );
        assert_eq!(catch_panic(|| Ok(7)), Ok(7));
        assert_eq!(
            catch_panic::<()>(|| Err("no road".to_owned())),
            Err("no road".to_owned())
        );
    }

    #[test]
    fn an_inner_panic_leaves_the_outer_work_guarded() {
        install_hook();
        let outcome = catch_panic(|| {
            let inner: Result<(), String> = catch_panic(|| panic!("inner"));
            assert!(inner.is_err());
            let text: Result<(), String> =
                catch_panic(|| std::panic::panic_any(String::from("second")));
            text.map_err(|error| format!("{error} in the outer"))
        });
        assert!(outcome.unwrap_err().ends_with("second in the outer"));
    }
}
