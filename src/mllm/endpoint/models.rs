//! The models that a server offers, from its list `/v1/models`.

use super::reply::shortened;
use serde_json::Value;

/// Most names in a message.
const MAX_NAMED: usize = 12;

/// A model of the list.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Offered {
    pub(super) id: String,
    /// Who owns it, by which servers name themselves: `llamacpp`, `vllm`, `sglang`, `library`.
    pub(super) owner: String,
    /// Whether it can chat: not an adapter of another model, and no model of embeddings.
    chats: bool,
}

/// The models of a list: in `data`, in `models`, or as a list of names or objects.
pub(super) fn offered(list: &Value) -> Vec<Offered> {
    let lists = [Some(list), list.get("data"), list.get("models")];
    let Some(models) = lists.into_iter().flatten().find_map(Value::as_array) else {
        return Vec::new();
    };
    models.iter().filter_map(model).collect()
}

fn model(entry: &Value) -> Option<Offered> {
    let text = |name: &str| {
        entry
            .get(name)
            .and_then(Value::as_str)
            .filter(|text| !text.is_empty())
    };
    let id = entry
        .as_str()
        .or_else(|| ["id", "model", "name"].into_iter().find_map(text))?;
    let is_embedding = id.to_ascii_lowercase().contains("embed")
        || text("type").is_some_and(|kind| kind == "embeddings");
    let chats = text("parent").is_none() && !is_embedding;
    Some(Offered {
        id: id.to_owned(),
        owner: text("owned_by").unwrap_or_default().to_owned(),
        chats,
    })
}

/// The model to ask where nobody named one: the only one that can chat.
pub(super) fn only(models: &[Offered]) -> Option<&Offered> {
    let mut chatting = models.iter().filter(|model| model.chats);
    chatting.next().filter(|_| chatting.next().is_none())
}

/// The names for a message; `hide` removes the key.
pub(super) fn named(models: &[Offered], hide: &dyn Fn(&str) -> String) -> String {
    let mut names: Vec<String> = models
        .iter()
        .take(MAX_NAMED)
        .map(|model| shortened(&hide(&model.id)))
        .collect();
    if models.len() > MAX_NAMED {
        names.push(format!("and {} more", models.len() - MAX_NAMED));
    }
    names.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn ids(list: &Value) -> Vec<String> {
        offered(list).into_iter().map(|model| model.id).collect()
    }

    #[test]
    fn lists_are_read_in_every_form() {
        for (what, list) in [
            (
                "OpenAI",
                json!({"object": "list", "data": [{"id": "a", "object": "model"}, {"id": "b"}]}),
            ),
            (
                "llama-server",
                json!({"models": [{"name": "x"}], "data": [{"id": "a"}, {"id": "b"}]}),
            ),
            (
                "Ollama's own",
                json!({"models": [{"name": "a", "model": "a"}, {"name": "b"}]}),
            ),
            ("Together", json!([{"id": "a"}, {"id": "b"}])),
            ("names alone", json!({"data": ["a", "b"]})),
            (
                "with nonsense",
                json!({"data": [{"id": "a"}, {"id": 3}, {"id": ""}, null, {"id": "b"}]}),
            ),
        ] {
            assert_eq!(ids(&list), ["a", "b"], "{what}");
        }
        for none in [
            json!({}),
            json!({"data": null}),
            json!("x"),
            json!({"error": "x"}),
        ] {
            assert_eq!(ids(&none), [] as [&str; 0], "{none}");
        }
    }

    #[test]
    fn the_only_model_that_chats_is_chosen() {
        let only_of = |list: Value| only(&offered(&list)).map(|model| model.id.clone());
        assert_eq!(only_of(json!(["a"])).as_deref(), Some("a"));
        let vllm = json!({"data": [{"id": "a", "parent": null}, {"id": "adapter", "parent": "a"}]});
        assert_eq!(only_of(vllm).as_deref(), Some("a"));
        assert_eq!(
            only_of(json!(["a", "text-embedding-nomic-embed-text-v1.5"])).as_deref(),
            Some("a")
        );
        assert_eq!(only_of(json!(["a", "b"])), None);
        assert_eq!(only_of(json!([])), None);
    }

    #[test]
    fn long_lists_are_cut() {
        let many = offered(&(0..20).map(|number| json!(format!("m{number}"))).collect());
        let named = named(&many, &str::to_owned);
        assert!(
            named.starts_with("m0, m1, ") && named.ends_with("m11, and 8 more"),
            "{named}"
        );
    }
}
