"""Where the tips of flexible links are, in their own frames."""

from __future__ import annotations

import casadi

from flexfmu.model.robot import Direction, Robot


class TipMap:
    """Displacements of link tips as functions of the elastic coordinates: linear, and less what bending takes away."""

    def __init__(self, robot: Robot) -> None:
        self._gains: dict[tuple[str, Direction], casadi.DM] = {}
        self._shortening: dict[str, tuple[int, casadi.SX]] = {}
        n = robot.q_e.numel()
        start = 0
        for link, part in robot.elastic:
            stop = start + part.q.numel()
            gain = casadi.DM.zeros(n, 1)
            gain[start:stop] = part.family.tips
            self._gains[link.name, part.family.direction] = casadi.sparsify(gain)
            if part.family.direction == "bending" and link.group in robot.shortening:
                self._shortening[link.name] = start, robot.shortening[link.group]
            start = stop
        self._none = casadi.DM(n, 1)
        self.twist = robot.twist_selection

    def gain(self, link: str, direction: Direction, q_e: casadi.SX) -> casadi.DM | casadi.SX:
        """Gradient (n, 1) of the tip's displacement by q_e: phi(1) of the link's family, less what shortens it."""
        linear = self._gains.get((link, direction), self._none)
        return linear if direction != "axial" or link not in self._shortening else linear - self._bend(link, q_e)

    def displacement(self, link: str, direction: Direction, q_e: casadi.SX) -> casadi.SX:
        """u(1) [m]."""
        linear = self._product(self._gains.get((link, direction), self._none), q_e)
        return linear if direction == "bending" else linear + self._curvature(link, q_e) / 2

    def rate(self, link: str, direction: Direction, q_e: casadi.SX, v_e: casadi.SX) -> casadi.SX:
        """u'(1) [m/s]."""
        return self._product(self.gain(link, direction, q_e), v_e)

    def acceleration(
        self, link: str, direction: Direction, q_e: casadi.SX, v_e: casadi.SX, a_e: casadi.SX
    ) -> casadi.SX:
        """u''(1) [m/s²]."""
        linear = self._product(self.gain(link, direction, q_e), a_e)
        return linear if direction == "bending" else linear + self._curvature(link, v_e)

    def _product(self, gain: casadi.DM | casadi.SX, coordinates: casadi.SX) -> casadi.SX:
        return casadi.dot(gain, coordinates) if coordinates.numel() else casadi.SX(0)

    def _bend(self, link: str, q_e: casadi.SX) -> casadi.SX:
        """S q within q_e, shape (n, 1)."""
        start, matrix = self._shortening[link]
        stop = start + matrix.shape[0]
        return casadi.vertcat(casadi.SX(start, 1), matrix @ q_e[start:stop], casadi.SX(q_e.numel() - stop, 1))

    def _curvature(self, link: str, coordinates: casadi.SX) -> casadi.SX:
        """-c' S c of the link's bending coordinates c, zero where bending doesn't shorten it."""
        return -casadi.dot(coordinates, self._bend(link, coordinates)) if link in self._shortening else casadi.SX(0)
