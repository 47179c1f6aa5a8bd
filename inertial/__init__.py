"""Physics and estimation of a strapdown block at rest and in motion: pure functions over arrays.

Frames of reference used everywhere below this package:

* **b** (body): the block's x, y, z; at zero attitude forward, left, up.
* **t** (tangent): axis 1 level along the azimuth (clockwise from north), axis 2 level to its left, axis 3 up.
* ``C_tb`` maps body to tangent: ``C_tb = Rz(-heading) @ Ry(-pitch) @ Rx(roll)``.

SI units throughout: m, s, rad, kg. Sensors are ordered accel x, y, z, gyro x, y, z.
"""
