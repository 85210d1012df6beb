//! The date that chat templates are told.

use minijinja::{Error, ErrorKind};

/// `strftime_now` of chat templates. The same chat must give the same prompt on every day, so it is always
/// 26 July 2024, 00:00:00: the date that Llama 3's own template takes when it is told none.
pub(super) fn format_fixed_date(format: &str) -> Result<String, Error> {
    let mut out = String::with_capacity(format.len());
    let mut characters = format.chars();
    while let Some(character) = characters.next() {
        if character != '%' {
            out.push(character);
            continue;
        }
        out.push_str(match characters.next() {
            Some('Y') => "2024",
            Some('y') => "24",
            Some('m') => "07",
            Some('d') => "26",
            Some('B') => "July",
            Some('b' | 'h') => "Jul",
            Some('A') => "Friday",
            Some('a') => "Fri",
            Some('j') => "208",
            Some('H' | 'M' | 'S') => "00",
            Some('I') => "12",
            Some('p') => "AM",
            Some('F') => "2024-07-26",
            Some('T') => "00:00:00",
            Some('%') => "%",
            other => {
                return Err(Error::new(
                    ErrorKind::InvalidOperation,
                    format!("strftime_now: the code %{} is not supported", other.unwrap_or(' ')),
                ));
            }
        });
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_date_is_formatted() {
        assert_eq!(format_fixed_date("%d %b %Y, 100%%").unwrap(), "26 Jul 2024, 100%");
        assert!(format_fixed_date("%Q").is_err());
        assert!(format_fixed_date("%").is_err());
    }
}
