//! How LLaVA is asked, where its GGUF files do not say.

/// Questions and answers as Vicuna's chats have them, the system prompt in front (LLaVA 1.5 and 1.6 on Vicuna).
const VICUNA: &str = "\
{%- macro parts(message) -%}
{%- for part in message['content'] -%}{{ '<image>\\n' if part['type'] == 'image' else part['text'] + ' ' }}{%- endfor -%}
{%- endmacro -%}
{%- for message in messages -%}
{{ '' if message['role'] == 'system' else message['role'].upper() + ': ' }}{{ parts(message) }}
{%- endfor -%}
{%- if add_generation_prompt -%}{{ 'ASSISTANT:' }}{%- endif -%}";

/// Mistral's instructions (LLaVA 1.6 on Mistral).
const MISTRAL: &str = "\
{%- macro parts(message) -%}
{%- for part in message['content'] -%}{{ '<image>\\n' if part['type'] == 'image' else part['text'] }}{%- endfor -%}
{%- endmacro -%}
{%- for message in messages -%}
{%- if message['role'] == 'system' -%}{{ '<<SYS>>\\n' + parts(message) + '\\n<</SYS>>\\n\\n' }}
{%- elif message['role'] == 'user' -%}{{ '[INST] ' + parts(message) + ' [/INST]' }}
{%- else -%}{{ ' ' + parts(message) + '</s>' }}
{%- endif -%}
{%- endfor -%}";

/// The template for a decoder of this name, and whose form of a chat it is.
pub(super) fn by_name(name: &str) -> (&'static str, &'static str) {
    if name.to_lowercase().contains("mistral") { (MISTRAL, "Mistral") } else { (VICUNA, "Vicuna") }
}
