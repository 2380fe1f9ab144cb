"""A floor, and the table that mugs stand on."""

from bra.tasks.nao_mugs.bullet import BulletClient

TABLE_HEIGHT = 0.34  # m, the table's top
TABLE_EDGE = 0.10  # m, x of the table's near edge
TABLE_DEPTH = 0.45  # m, along x
TABLE_WIDTH = 0.60  # m, along y
TABLE_THICKNESS = 0.02  # m
TABLE_COLOUR = (0.82, 0.68, 0.47)
FLOOR_SIZE = 6.0  # m
FLOOR_COLOUR = (0.62, 0.66, 0.70)
FRICTION = 0.8  # Bullet multiplies it with the other body's

_TABLE_CENTRE = TABLE_EDGE + TABLE_DEPTH / 2  # m, along x


def furnish(client: BulletClient) -> tuple[int, int]:
    """Puts a table top and a floor into a simulation; returns their bodies' ids."""
    top = (TABLE_DEPTH / 2, TABLE_WIDTH / 2, TABLE_THICKNESS / 2)
    floor = (FLOOR_SIZE / 2, FLOOR_SIZE / 2, 0.05)
    return (
        _boxes(client, top, [(_TABLE_CENTRE, 0.0, TABLE_HEIGHT - top[2])], TABLE_COLOUR),
        _boxes(client, floor, [(0.0, 0.0, -floor[2])], FLOOR_COLOUR),
    )


def add_legs(client: BulletClient) -> None:
    """The table's legs, out of the robot's sight and reach."""
    half = (0.016, 0.016, (TABLE_HEIGHT - TABLE_THICKNESS) / 2)
    x, y = TABLE_DEPTH / 2 - 0.03, TABLE_WIDTH / 2 - 0.03
    corners = [(_TABLE_CENTRE + i * x, j * y, half[2]) for i in (1, -1) for j in (1, -1)]
    _boxes(client, half, corners, TABLE_COLOUR)


def _boxes(
    client: BulletClient,
    half: tuple[float, float, float],
    centres: list[tuple[float, float, float]],
    colour: tuple[float, float, float],
) -> int:
    """A fixed body of equal boxes, with half their edges given; its id."""
    shapes = {
        "shapeTypes": [client.GEOM_BOX] * len(centres),
        "halfExtents": [half] * len(centres),
    }
    body = client.createMultiBody(
        0.0,
        client.createCollisionShapeArray(**shapes, collisionFramePositions=centres),
        client.createVisualShapeArray(
            **shapes, visualFramePositions=centres, rgbaColors=[[*colour, 1.0]] * len(centres)
        ),
    )
    client.changeDynamics(body, -1, lateralFriction=FRICTION)
    return int(body)
