"""Facts of the schemas DCC 3.2.1 and D-SI 2.1.0: what each type holds, in which order, how often; its attributes.

Taken from the published schemas, not from the code under test. ``name:type`` is a child element; ? * + say how often,
( | ) is a choice, & in front of a model means any order. A type without a model is simple: PATTERNS, WORDS, LISTS.
"""

ANY_ID = "id refId refType"
DCC_TYPES: dict[str, tuple[str, str]] = {
    "digitalCalibrationCertificate": (
        "administrativeData:administrativeData measurementResults:measurementResultList comment:anything? "
        "document:byteData?", "schemaVersion!"),
    "administrativeData": (
        "& dccSoftware:softwareList refTypeDefinitions:refTypeDefinitionList? coreData:coreData items:itemList "
        "calibrationLaboratory:calibrationLaboratory respPersons:respPersonList customer:contact "
        "statements:statementList?", ""),
    "softwareList": ("software:software+", ""),
    "software": ("name:text release:notEmpty type:softwareKind? description:richContent?", "id refType"),
    "refTypeDefinitionList": ("refTypeDefinition:refTypeDefinition+", ""),
    "refTypeDefinition": (
        "name:text description:richContent? namespace:notEmpty link:notEmpty release:notEmpty? value:notEmpty? "
        "procedure:notEmpty?", "refType"),
    "measuringEquipmentList": (
        "name:text? equipmentClass:equipmentClass* description:richContent? owner:contact? "
        "identifications:identificationList? measuringEquipment:measuringEquipment+", ""),
    "measuringEquipment": (
        "name:text equipmentClass:equipmentClass* description:richContent? certificate:hash? "
        "manufacturer:contactNotStrict? model:notEmpty? identifications:identificationList? "
        "measuringEquipmentQuantities:measuringEquipmentQuantityList?", "id refType"),
    "measuringEquipmentQuantityList": ("measuringEquipmentQuantity:primitiveQuantity+", ""),
    "primitiveQuantity": (
        "name:text? description:richContent? ( noQuantity:richContent | charsXMLList:chars | si:real | si:hybrid | "
        "si:complex | si:constant | si:realListXMLList )", ANY_ID),
    "coreData": (
        "countryCodeISO3166_1:country usedLangCodeISO639_1:language+ mandatoryLangCodeISO639_1:language+ "
        "uniqueIdentifier:notEmpty identifications:identificationList? receiptDate:date? beginPerformanceDate:date "
        "endPerformanceDate:date performanceLocation:performanceLocation issueDate:date? "
        "reportAmendedSubstituted:reportAmendedSubstituted? previousReport:hash?", ""),
    "reportAmendedSubstituted": ("typeOfChange:change replacedUniqueIdentifier:notEmpty", "id refType"),
    "equipmentClass": ("reference:notEmpty classID:notEmpty", "id refType"),
    "itemList": (
        "name:text? equipmentClass:equipmentClass* description:richContent? owner:contact? "
        "manufacturer:contactNotStrict? identifications:identificationList? item:item+", ""),
    "item": (
        "name:text equipmentClass:equipmentClass* description:richContent? installedSoftwares:softwareList? "
        "manufacturer:contactNotStrict? model:notEmpty? identifications:identificationList "
        "itemQuantities:itemQuantityList?", "id refType"),
    "itemQuantityList": ("itemQuantity:primitiveQuantity+", ""),
    "identificationList": ("identification:identification+", ""),
    "identification": ("issuer:issuer value:notEmpty name:text?", "id refType"),
    "calibrationLaboratory": (
        "calibrationLaboratoryCode:notEmpty? contact:contact cryptElectronicSeal:boolean? "
        "cryptElectronicSignature:boolean? cryptElectronicTimeStamp:boolean?", ""),
    "respPersonList": ("respPerson:respPerson+", ""),
    "respPerson": (
        "person:contactNotStrict description:richContent? role:notEmpty? mainSigner:boolean? "
        "cryptElectronicSeal:boolean? cryptElectronicSignature:boolean? cryptElectronicTimeStamp:boolean?",
        "id refType"),
    "statementList": ("statement:statementMetaData+", ""),
    "measurementResultList": ("measurementResult:measurementResult+", ""),
    "measurementResult": (
        "name:text description:richContent? usedMethods:usedMethodList? usedSoftware:softwareList? "
        "measuringEquipments:measuringEquipmentList? influenceConditions:influenceConditionList? results:resultList "
        "measurementMetaData:measurementMetaDataList?", ANY_ID),
    "usedMethodList": ("usedMethod:usedMethod+", ""),
    "usedMethod": ("name:text description:richContent? norm:notEmpty* reference:notEmpty*", "id refType"),
    "influenceConditionList": ("influenceCondition:condition+", ""),
    "condition": (
        "name:text description:richContent? status:adjustment? certificate:hash? data:data", "id refType"),
    "resultList": ("result:result+", ""),
    "result": ("name:text description:richContent? data:data", ANY_ID),
    "data": (
        "( text:richContent | formula:formula | byteData:byteData | xml:xml | quantity:quantity | list:list )+",
        ANY_ID),
    "quantity": (
        "name:text? description:richContent? ( noQuantity:richContent | charsXMLList:chars | si:real | si:list | "
        "si:hybrid | si:complex | si:constant | si:realListXMLList ) relativeUncertainty:relativeUncertainty? "
        "usedMethods:usedMethodList? usedSoftware:softwareList? measuringEquipments:measuringEquipmentList? "
        "influenceConditions:influenceConditionList? measurementMetaData:measurementMetaDataList?", ANY_ID),
    "list": (
        "name:text? description:richContent? ( dateTime:dateTime? | dateTimeXMLList:dateTimes? ) "
        "( list:list | quantity:quantity )+ usedMethods:usedMethodList? usedSoftware:softwareList? "
        "measuringEquipments:measuringEquipmentList? influenceConditions:influenceConditionList? "
        "measurementMetaData:measurementMetaDataList?", ANY_ID),
    "measurementMetaDataList": ("metaData:statementMetaData+", ""),
    "statementMetaData": (
        "name:text? description:richContent? countryCodeISO3166_1:country* convention:notEmpty? traceable:boolean? "
        "norm:notEmpty* reference:notEmpty* declaration:richContent? ( valid:boolean | validXMLList:booleans )? "
        "date:date? period:duration? respAuthority:contact? "
        "( conformity:conformity | conformityXMLList:conformities )? "
        "data:data? nonSIDefinition:notEmpty? nonSIUnit:notEmpty? location:location?", ANY_ID),
    "location": (
        "( city:notEmpty | countryCode:country | postCode:notEmpty | postOfficeBox:notEmpty | state:notEmpty | "
        "street:notEmpty | streetNo:notEmpty | further:richContent )+", ""),
    "contact": (
        "name:text eMail:notEmpty? phone:notEmpty? fax:notEmpty? location:location descriptionData:byteData?", "id"),
    "contactNotStrict": (
        "name:text eMail:notEmpty? phone:notEmpty? fax:notEmpty? location:location? descriptionData:byteData?", ANY_ID),
    "hash": (
        "referral:text referralID:notEmpty procedure:notEmpty value:notEmpty description:richContent? "
        "inValidityRange:boolean? traceable:boolean? linkedReport:hash?", "id refType"),
    "text": ("content:stringWithLang+", "id"),
    "richContent": (
        "name:text? ( content:stringWithLang | file:byteData | formula:formula )*", ANY_ID),
    "byteData": ("name:text? description:richContent? fileName:notEmpty mimeType:notEmpty dataBase64:base64", ANY_ID),
    "formula": ("( latex:string | mathml:xml )", ANY_ID),
    "stringWithLang": ("", "lang " + ANY_ID),
    "performanceLocation": ("", ANY_ID),
}  # fmt: skip
SI_TYPES: dict[str, tuple[str, str]] = {
    "real": (
        "label:string? value:decimal unit:string dateTime:dateTime? "
        "( expandedUnc:expandedUnc | coverageInterval:coverageInterval )?", ""),
    "realListXMLList": (
        "labelXMLList:chars? valueXMLList:decimals unitXMLList:chars dateTimeXMLList:dateTimes? "
        "( expandedUncXMLList:expandedUncXMLList | coverageIntervalXMLList:coverageIntervalXMLList )?", ""),
    "expandedUnc": (
        "uncertainty:uncertainty coverageFactor:factor coverageProbability:probability distribution:string?", ""),
    "expandedUncXMLList": (
        "uncertaintyXMLList:uncertainties coverageFactorXMLList:factors coverageProbabilityXMLList:probabilities "
        "distributionXMLList:chars?", ""),
    "coverageInterval": (
        "standardUnc:uncertainty intervalMin:decimal intervalMax:decimal coverageProbability:probability "
        "distribution:string?", ""),
    "coverageIntervalXMLList": (
        "standardUncXMLList:uncertainties intervalMinXMLList:decimals intervalMaxXMLList:decimals "
        "coverageProbabilityXMLList:probabilities distributionXMLList:chars?", ""),
}  # fmt: skip
_MANTISSA = r"((\d*\.\d+)|(\d+\.\d*)|(\d+\.?))"
PATTERNS = {
    "notEmpty": r"[^\s]+(\s+[^\s]+)*", "country": "[A-Z]{2}", "language": "[a-z]{2}",
    "decimal": rf"[-+]?{_MANTISSA}([Ee][-+]?\d+)?", "uncertainty": rf"\+?{_MANTISSA}([Ee][-+]?\d+)?",
    "factor": r"\+?(([1-9]\d*\.\d*)|([1-9]\d*))", "probability": r"\+?((0(\.\d*)?)|(1(\.0*)?))",
    "boolean": "true|false|0|1", "date": r"\d{4}-\d{2}-\d{2}",
}  # fmt: skip
WORDS = {
    "softwareKind": "application bios driver editor firmware library os other",
    "issuer": "manufacturer calibrationLaboratory customer owner other",
    "performanceLocation": "laboratory customer laboratoryBranch customerBranch other",
    "adjustment": "beforeAdjustment afterAdjustment beforeRepair afterRepair",
    "conformity": "pass fail conditionalPass conditionalFail noPass noFail",
    "change": "amended substituted",
}
LISTS = {
    "chars": "string", "decimals": "decimal", "uncertainties": "uncertainty", "factors": "factor",
    "probabilities": "probability", "conformities": "conformity", "booleans": "boolean", "dateTimes": "dateTime",
}  # fmt: skip
BUILT_IN = {
    "string": "string", "dateTime": "dateTime", "duration": "duration", "base64": "base64Binary",
    "stringWithLang": "string",
}  # fmt: skip
SCHEMA_VERSION = "3.2.1"
NAMESPACES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}

# Identifiers of units in D-SI (its list of units, from the SI brochure), for those a bench can need.
_UNITS = """metre kilogram second ampere kelvin mole candela one day hour minute degree arcminute arcsecond gram radian
    hertz newton pascal joule watt coulomb volt farad ohm siemens weber tesla henry degreecelsius lumen lux"""
DSI_UNITS = frozenset(_UNITS.split())
_PREFIXES = "deca hecto kilo mega giga tera peta exa deci centi milli micro nano pico femto atto"
DSI_PREFIXES = frozenset(_PREFIXES.split())
