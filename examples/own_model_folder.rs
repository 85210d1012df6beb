//! A model from a folder as Hugging Face writes it: `cargo run --release --example own_model_folder
//! [FOLDER]`

#![allow(clippy::print_stdout, reason = "an example prints what it does")]

use planagent::{Agent, Challenge, Scenario, simulate};
use std::path::Path;

fn main() -> planagent::Result<()> {
    // The folder needs config.json, the weights as safetensors, tokenizer.json and
    // preprocessor_config.json. Without an argument this takes the folder of nano in this
    // repository.
    let nano = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/nano");
    let folder = std::env::args()
        .nth(1)
        .unwrap_or_else(|| nano.to_string_lossy().into_owned());

    // A folder says nothing about prompts. Nano was trained on the compact ones; other models get
    // the paper's by default.
    let mut agent = Agent::builder()
        .model(folder)
        .trust_model()
        .prompts("compact")
        .offline()
        .build()?;
    let scenario = Scenario::open("generated/stationary_in_traffic/1")?;
    let run = simulate(&scenario, &mut agent, Challenge::NonReactive)?;
    println!(
        "score {:.3} after {} planning calls",
        run.score(),
        run.calls.len()
    );
    Ok(())
}
