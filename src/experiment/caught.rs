//! A panic inside a drive is the error of that drive, not the end of the run.

use std::any::Any;
use std::cell::RefCell;
use std::panic::{self, AssertUnwindSafe, PanicHookInfo};
use std::sync::Once;

thread_local! {
    /// While a drive runs on this thread: where it panicked, once it has.
    static PLACE: RefCell<Option<Place>> = const { RefCell::new(None) };
}

/// What the hook leaves for [`caught`].
enum Place {
    /// Nothing has happened yet.
    Quiet,
    /// File, line and column of a panic.
    At(String),
}

/// Runs `work`; a panic becomes an error with its message and place. Nothing is printed then.
///
/// # Errors
/// When `work` fails or panics.
pub(super) fn caught<T>(work: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    note_places();
    let before = PLACE.replace(Some(Place::Quiet));
    let outcome = panic::catch_unwind(AssertUnwindSafe(work));
    let place = PLACE.replace(before);
    outcome.unwrap_or_else(|payload| {
        let message = message(payload.as_ref());
        Err(match place {
            Some(Place::At(place)) => format!("panicked at {place}: {message}"),
            _ => format!("panicked: {message}"),
        })
    })
}

/// Puts a hook before the present one, once: the place of a panic is known to hooks alone.
fn note_places() {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let other = panic::take_hook();
        panic::set_hook(Box::new(move |info: &PanicHookInfo<'_>| {
            let watched = PLACE.with_borrow_mut(|place| {
                let watched = place.is_some();
                if watched {
                    *place = Some(Place::At(info.location().map_or_else(String::new, ToString::to_string)));
                }
                watched
            });
            if !watched {
                other(info);
            }
        }));
    });
}

fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().copied();
    text.or_else(|| payload.downcast_ref::<String>().map(String::as_str)).unwrap_or("no message").to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_an_error_with_message_and_place() {
        let outcome: Result<(), String> = caught(|| panic!("the wheel came off after {} m", 3));
        let error = outcome.unwrap_err();
        assert!(error.contains("caught.rs") && error.contains("the wheel came off after 3 m"), "{error}");
        assert_eq!(caught(|| Ok(7)), Ok(7));
        assert_eq!(caught::<()>(|| Err("no road".to_owned())), Err("no road".to_owned()));
    }

    #[test]
    fn an_inner_panic_leaves_the_outer_work_watched() {
        let outcome = caught(|| {
            let inner: Result<(), String> = caught(|| panic!("inner"));
            assert!(inner.is_err());
            let text: Result<(), String> = caught(|| std::panic::panic_any(String::from("second")));
            text.map_err(|error| format!("{error} in the outer"))
        });
        assert!(outcome.unwrap_err().ends_with("second in the outer"));
    }
}
