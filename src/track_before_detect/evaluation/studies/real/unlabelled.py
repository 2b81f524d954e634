"""What is to be seen in public recordings and has no label, listed by hand."""

from track_before_detect.evaluation.studies.real.truth import Other

# Looked at frame by frame. Listed are birds and aircraft; not what belongs to the scene and is
# merely bright, such as roofs, lamps, hay bales, glints on water and the echoes of a codec.
OTHERS: dict[str, tuple[Other, ...]] = {
    'ir_antiuav4_birds_pan': (
        # Its last bird flies at the left edge, 110 px behind the middle.
        Other('a flock of about 100 birds', (
            (0, 118, 93), (6, 149, 93), (12, 180, 93), (18, 199, 93), (24, 227, 93),
            (30, 259, 93), (36, 292, 93), (42, 325, 93), (48, 357, 93), (54, 371, 93),
            (60, 406, 93), (66, 429, 93)), (120, 27)),
    ),
    'IR_BIRD_023': (
        Other('a second bird, fainter', (
            (0, 206, 155), (30, 194, 153), (60, 181, 151), (90, 168.5, 150), (120, 157, 149),
            (140, 149, 149)), (5, 4)),
        Other('a third bird, fainter', (
            (20, 60, 162), (30, 55, 161), (60, 36, 157), (90, 24.5, 154), (120, 13, 151)),
            (5, 4)),
    ),
    'IR_HELICOPTER_053': (
        Other('a small bright thing that hangs above the horizon', (
            (0, 108.5, 129), (319, 108.5, 129)), (4, 4)),
    ),
}
