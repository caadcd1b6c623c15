"""Aircraft that are flown to make records: trim, manoeuvres, pilot inputs, integration."""
