"""Depth as sensors measure it, and the intrinsics of sensors.

sensor = depth_sensor("carmine")                   # or DepthSensor(noise=(0.001, 0.0, 0.002), a=1.02)
measured = sensor.measure(exact_depth, K, rng)     # float32 metres, 0 where nothing is measured
camera = sensor_camera("carmine")
"""

from pipeline.synth.sensors.depth_sensor import DepthSensor
from pipeline.synth.sensors.presets import CAMERAS, SENSORS, depth_sensor, sensor_camera

__all__ = ["CAMERAS", "SENSORS", "DepthSensor", "depth_sensor", "sensor_camera"]
