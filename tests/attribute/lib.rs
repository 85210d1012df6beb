//! `#[test]` for a test binary with a harness of its own, where the compiler's attribute would
//! remove the function.

use proc_macro::{TokenStream, TokenTree};

/// Registers a function with `crate::harness`, under its path.
///
/// # Panics
/// If it does not stand on a function.
#[proc_macro_attribute]
pub fn test(_: TokenStream, function: TokenStream) -> TokenStream {
    let name = name(function.clone()).expect("#[test] stands on a function");
    let registered = format!(
        "::inventory::submit! {{
            crate::harness::Test {{
                path: concat!(module_path!(), \"::{name}\"),
                is_needy: crate::harness::is_needy({name}),
                run: || crate::harness::Outcome::completion({name}()),
            }}
        }}"
    );
    let mut tokens = function;
    tokens.extend(registered.parse::<TokenStream>().expect("an item"));
    tokens
}

/// The identifier behind the first `fn`.
fn name(function: TokenStream) -> Option<String> {
    let mut words = function
        .into_iter()
        .skip_while(|token| !is_word(token, "fn"));
    words.nth(1).map(|token| token.to_string())
}

fn is_word(token: &TokenTree, word: &str) -> bool {
    matches!(token, TokenTree::Ident(name) if name.to_string() == word)
}
