//! Temporary names of files that are being written. Each is used once: two processes that write one
//! file do not meet.

use std::process;
use std::sync::atomic::{AtomicU64, Ordering};

/// How the name of an unfinished file or folder begins. A process that was killed may leave one; it
/// is safe to delete.
pub const UNFINISHED: &str = ".unfinished-";
/// Maximum part of the final name in the temporary one, bytes: file systems allow 255 for all of
/// it.
const MAX_STEM: usize = 160;

static COUNT: AtomicU64 = AtomicU64::new(0);

/// A temporary name for a file, which nobody else uses.
pub(super) fn temporary_name(name: &str) -> String {
    let number = COUNT.fetch_add(1, Ordering::Relaxed);
    format!("{}{}-{number}", stem(name), process::id())
}

/// Whether a name is a temporary one of this file, of any process.
pub(super) fn is_of(temporary: &str, name: &str) -> bool {
    let Some(rest) = temporary.strip_prefix(&stem(name)) else {
        return false;
    };
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    rest.split_once('-')
        .is_some_and(|(process, number)| is_number(process) && is_number(number))
}

fn stem(name: &str) -> String {
    let end = name.floor_char_boundary(MAX_STEM);
    format!("{UNFINISHED}{}-", &name[..end])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_temporary_name_belongs_to_one_file() {
        let [first, second] = [temporary_name("page.html"), temporary_name("page.html")];
        assert!(first != second && is_of(&first, "page.html") && is_of(&second, "page.html"));
        assert!(!is_of(&first, "page") && !is_of(&first, "age.html"));
        assert!(!is_of(".unfinished-page.html-x-1", "page.html"));
        let long = "ä".repeat(200);
        assert!(temporary_name(&long).len() < 255 && is_of(&temporary_name(&long), &long));
    }
}
