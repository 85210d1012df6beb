//! The names of the tensors of a PEFT adapter.

/// What every name begins with.
const PREFIX: &str = "base_model.model.";
/// What wraps a layer, or a parameter among several of a module.
const BASE_LAYER: &str = ".base_layer";

/// A tensor's name in its parts.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Name<'a> {
    /// The module in the trainer's model.
    pub(super) module: &'a str,
    pub(super) role: Role<'a>,
}

/// What a tensor is to its module.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Role<'a> {
    A,
    B,
    /// The bias of B.
    BBias,
    EmbeddingA,
    EmbeddingB,
    Magnitude,
    /// New rows of an embedding.
    Tokens,
    /// A parameter of the module (`weight`, `bias`) in place of the base's; the second is whether
    /// the module is adapted.
    Saved(&'a str, bool),
}

/// Ends of names; some trainers write a magnitude as a module.
const ROLES: [(&str, Role<'static>); 8] = [
    (".lora_A.weight", Role::A),
    (".lora_B.weight", Role::B),
    (".lora_B.bias", Role::BBias),
    (".lora_embedding_A", Role::EmbeddingA),
    (".lora_embedding_B", Role::EmbeddingB),
    (".lora_magnitude_vector", Role::Magnitude),
    (".lora_magnitude_vector.weight", Role::Magnitude),
    (".token_adapter.trainable_tokens_delta", Role::Tokens),
];

impl<'a> Name<'a> {
    /// Reads a name; none if PEFT gives no tensor of LoRA such a name.
    pub(super) fn parse(name: &'a str) -> Option<Self> {
        let rest = name.strip_prefix(PREFIX)?;
        let known = ROLES
            .iter()
            .find_map(|(end, role)| Some((rest.strip_suffix(end)?, *role)));
        if let Some((module, role)) = known {
            return Some(Self { module, role });
        }
        let (module, parameter) = rest.rsplit_once('.')?;
        let named = |part: &str| part.starts_with("lora_") || part == "token_adapter";
        if rest.split('.').any(named) {
            return None;
        }
        let (module, adapted) = match module.strip_suffix(BASE_LAYER) {
            Some(module) => (module, true),
            None => (module, false),
        };
        let role = Role::Saved(parameter, adapted);
        Some(Self { module, role })
    }

    /// The module without the wrappers of a parameter, and their number.
    pub(super) fn unwrapped(module: &'a str) -> (&'a str, usize) {
        let mut inner = module;
        let mut wrappers = 0;
        while let Some(rest) = inner.strip_suffix(BASE_LAYER) {
            inner = rest;
            wrappers += 1;
        }
        (inner, wrappers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_in_their_parts() {
        let module = "model.layers.0.self_attn.q_proj";
        for (end, role) in ROLES {
            let name = format!("{PREFIX}{module}{end}");
            assert_eq!(Name::parse(&name), Some(Name { module, role }), "{name}");
        }
        let saved = |name: &'static str| Name::parse(name).map(|name| (name.module, name.role));
        assert_eq!(
            saved("base_model.model.model.norm.weight"),
            Some(("model.norm", Role::Saved("weight", false)))
        );
        assert_eq!(
            saved("base_model.model.a.q_proj.base_layer.bias"),
            Some(("a.q_proj", Role::Saved("bias", true)))
        );
        assert_eq!(
            Name::unwrapped("a.experts.base_layer.base_layer"),
            ("a.experts", 2)
        );
        for other in [
            "model.layers.0.q_proj.lora_A.weight",
            "base_model.model.a.lora_A.default.weight",
            "base_model.model.weight",
            "base_model.model.a.lora_ga.weight",
        ] {
            assert_eq!(saved(other), None, "{other}");
        }
    }
}
