//! The tokenizers of this build, which use the crate `fancy-regex`, against those of the Python
//! package, which use Oniguruma.

use super::fixture;
use serde_json::Value;
use std::path::Path;
use tokenizers::Tokenizer;

#[test]
fn regular_expressions_split_texts_as_oniguruma_does() {
    let text = std::fs::read_to_string(fixture("token_ids").join("token_ids.json")).unwrap();
    let expected: Value = serde_json::from_str(&text).unwrap();
    let texts = expected["texts"].as_array().unwrap();
    for (file, rows) in expected["ids"].as_object().unwrap() {
        let tokenizer =
            Tokenizer::from_file(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap();
        for (text, ids) in texts.iter().zip(rows.as_array().unwrap()) {
            let found = tokenizer
                .encode_fast(text.as_str().unwrap(), false)
                .unwrap();
            assert_eq!(serde_json::json!(found.get_ids()), *ids, "{file}: {text}");
        }
    }
}
