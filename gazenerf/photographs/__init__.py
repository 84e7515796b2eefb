"""From a photograph to a fitted head model: pictures, landmarks, data normalisation and the 3DMM fit."""
