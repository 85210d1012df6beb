"""The vision tower of Qwen3-VL for openvino.py: patches in blocks of what becomes a token, positions in two dimensions, and
numbers for early layers of the decoder."""


class QwenTower:
    """A tower that takes a square of any size whose side is a multiple of a token's."""

    def __init__(self, folder, compiled, recipe, like):
        self.recipe, self.side = recipe, like["image_side"]
        patch, merged = recipe["patches"], recipe["merged"]
        self.along = self.side // patch
        # Tokens along a side: as many positions the picture takes.
        self.positions = self.along // merged
        self.image_tokens = self.positions**2
        if self.side % (patch * merged) or self.image_tokens != like["image_tokens"]:
            problem = f"{folder} makes {self.image_tokens} tokens of {self.side} px"
            raise Problem(f"{problem}, and the image has {like['image_tokens']}")
        self.patches, self.layers = (
            compiled(folder / f"openvino_vision_embeddings{part}_model.xml") for part in ("", "_merger")
        )
        places = self.in_blocks(np.stack(np.mgrid[: self.along, : self.along], axis=-1)).astype(np.float32)
        half = recipe["head"] // 2
        frequencies = 10000.0 ** -(np.arange(0, half, 2, dtype=np.float32) / half)
        self.angles = (places[:, :, None] * frequencies).reshape(len(places), -1)
        self.mask = np.zeros((1, len(places), len(places)), np.float32)
        self.learned = self.interpolated(compiled(folder / "openvino_vision_embeddings_pos_model.xml"))

    def in_blocks(self, grid):
        """The cells of a grid in rows, those of a token together."""
        merged, blocks = self.recipe["merged"], self.positions
        cells = grid.reshape(blocks, merged, blocks, merged, *grid.shape[2:])
        return cells.swapaxes(1, 2).reshape(self.along**2, *grid.shape[2:])

    def interpolated(self, table):
        """The learned positions of the patches: a mean of the four nearest in the table's grid."""
        last = round(self.recipe["places"] ** 0.5) - 1
        ends = np.linspace(0, last, self.along, dtype=np.float32)
        low = ends.astype(np.int64)
        high, share = np.minimum(low + 1, last), ends - low
        sides = [(row, column) for row in ((low, 1 - share), (high, share)) for column in ((low, 1 - share), (high, share))]
        places = [rows[:, None] * (last + 1) + columns for (rows, _), (columns, _) in sides]
        weights = [down[:, None] * right for (_, down), (_, right) in sides]
        table.infer([np.stack(places).reshape(len(sides), -1)])
        values = table.get_output_tensor(0).data.reshape(len(sides), self.along, self.along, -1)
        return self.in_blocks((values * np.stack(weights)[..., None]).sum(axis=0))

    def encode(self, pixels):
        """The numbers of the tokens of a square picture, and those for early layers."""
        recipe, patch = self.recipe, self.recipe["patches"]
        picture = normalized(pixels, self.side, recipe)
        grid = picture.reshape(3, self.along, patch, self.along, patch).transpose(1, 3, 0, 2, 4)
        cells = self.in_blocks(np.ascontiguousarray(grid))
        # A still picture is the same in each frame of a patch.
        frames = np.repeat(cells[:, :, None], recipe["frames"], axis=2)
        self.patches.infer([frames.reshape(len(cells), -1)])
        hidden = self.patches.get_output_tensor(0).data.reshape(len(cells), -1) + self.learned
        self.layers.infer({"hidden_states": hidden, "attention_mask": self.mask, "rotary_pos_emb": self.angles})
        rows, deep = (self.layers.get_output_tensor(index).data.copy() for index in range(2))
        return Features(rows.reshape(self.image_tokens, -1), deep.reshape(-1, self.image_tokens, rows.shape[-1]))

    def places_of(self, start):
        """The positions of the picture's tokens in three axes, from `start` on."""
        rows, columns = np.divmod(np.arange(self.image_tokens), self.positions)
        return start + np.stack([np.zeros_like(rows), rows, columns])
