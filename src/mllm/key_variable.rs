//! Which environment variables a description may name as the key of its server. A description may
//! come from elsewhere, and the value of the variable is sent to a server that it names.

use std::env;

/// Variable with names that its user allows beside the usual ones, separated by commas.
pub(super) const ALLOWED: &str = "PLANAGENT_KEY_ENV";
/// How the names of variables end that hold keys of servers.
const ENDINGS: [&str; 2] = ["_API_KEY", "_TOKEN"];

/// Refuses a variable that is not meant as the key of a server, unless the user allows its name.
pub(super) fn check(variable: &str) -> Result<(), String> {
    let is_allowed = || env::var(ALLOWED).is_ok_and(|allowed| is_among(variable, &allowed));
    if is_usual(variable) || is_allowed() {
        return Ok(());
    }
    Err(format!(
        "key_env is {}, which a description may not name: the variable of a key ends in {}. If you want its value sent to \
         the server, allow it with {ALLOWED}={0}",
        variable.escape_debug(),
        ENDINGS.join(" or "),
    ))
}

fn is_usual(variable: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
    variable.chars().all(plain)
        && ENDINGS.iter().any(|ending| {
            variable
                .to_ascii_uppercase()
                .strip_suffix(ending)
                .is_some_and(|rest| !rest.is_empty())
        })
}

fn is_among(variable: &str, allowed: &str) -> bool {
    !variable.is_empty() && allowed.split(',').any(|name| name.trim() == variable)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_secrets_of_the_environment_are_no_keys() {
        for usual in ["OPENAI_API_KEY", "MY_API_KEY", "HF_TOKEN", "my_api_key"] {
            assert_eq!(check(usual), Ok(()), "{usual}");
        }
        for other in [
            "AWS_SECRET_ACCESS_KEY",
            "PATH",
            "HOME",
            "",
            "_API_KEY",
            "A_TOKEN_",
            "A B_TOKEN",
            "GPG_PASSPHRASE",
        ] {
            let problem = check(other).unwrap_err();
            assert!(problem.contains(ALLOWED), "{problem}");
        }
        assert!(is_among("AWS_KEY", "X, AWS_KEY") && !is_among("AWS_KEY", "AWS_KEY_2,"));
    }
}
