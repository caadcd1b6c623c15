"""Aircraft that fly under a model of effects: equations of motion in three and in six degrees of freedom."""
