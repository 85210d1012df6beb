//! `planagent models fetch`.

use crate::{Exit, Printer};
use anyhow::Context;
use planagent_mllm::{ModelRegistry, in_bytes};

/// Downloads models of the hub with their tokenizers, and prints the folder of each.
pub(super) fn run(
    models: &[String],
    registry: &ModelRegistry,
    printer: Printer,
) -> anyhow::Result<Exit> {
    for model in models {
        let spec = registry.find(model)?;
        let place = registry
            .fetch(&spec)
            .with_context(|| format!("cannot fetch the model '{}'", spec.name))?;
        let bytes = place.weight_bytes()?;
        let place = place.path();
        if printer.is_json() {
            printer.json(&serde_json::json!({"model": model, "place": place.to_string_lossy(), "bytes": bytes}))?;
        } else {
            printer.line(format!(
                "{model}: {} in {}",
                in_bytes(bytes),
                place.display()
            ));
        }
    }
    Ok(Exit::Success)
}
