"""Find, name and prove the physical effect that the first-order model is missing.

Examples
--------
>>> from microbot_ros.discovery.report.words import interval
>>> from microbot_ros.discovery.result import Estimate
>>> interval('wx_um_s', Estimate.normal(0.58e-6, 0.02e-6))
'0.580 ± 0.039 µm/s'
"""
